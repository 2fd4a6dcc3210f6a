"""Runs beside the user interface: processes and their supervision, recorders, signals, priorities."""
