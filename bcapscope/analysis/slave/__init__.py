"""Slave-mode sessions: detection, timing, motion, and a model of the controller's buffer."""
