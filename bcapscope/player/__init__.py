"""Trajectories: reading, checking before anything moves, and playing in slave mode."""
