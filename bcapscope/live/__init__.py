"""What runs beside the user: processes and their supervision, recorders, signals, priorities."""
