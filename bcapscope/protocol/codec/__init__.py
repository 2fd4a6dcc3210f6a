"""Frames, VARIANTs and byte streams: bytes to values and back."""
