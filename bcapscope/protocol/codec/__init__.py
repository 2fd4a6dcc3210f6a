"""Frames, VARIANTs and byte streams: decode bytes to values and encode values to bytes."""
