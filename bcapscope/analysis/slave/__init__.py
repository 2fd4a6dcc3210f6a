"""Slave-mode sessions: their detection, timing and motion, and a model of the controller's buffer."""
