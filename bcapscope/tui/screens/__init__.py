"""Screens of `bcapscope tui`."""
