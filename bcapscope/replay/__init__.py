"""Replay of recorded sessions, as the client or as the controller."""
