"""Replay a recorded session, in the role of the client or of the controller."""
