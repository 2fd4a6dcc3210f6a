"""Faults as data, and their application to the messages of the proxy and the simulator."""
