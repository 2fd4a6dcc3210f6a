"""Simulator, proxy and pytest plugin for the tests of b-CAP clients."""
