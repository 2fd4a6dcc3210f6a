"""Code that runs in the background while the user interface runs: processes and their supervision, recorders,
signals, priorities.
"""
