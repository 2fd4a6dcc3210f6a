"""Slave modes, slvMove formats, poses, and the values that slvMove carries."""
