"""Code that runs beside the user interface: processes, their supervision, recorders, signals, priorities."""
