"""Slave modes, formats of slvMove, poses, and the values in the frames of slvMove."""
