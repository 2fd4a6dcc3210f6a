"""b-CAP itself: frames, VARIANTs, functions, commands and result codes.

Standard library only, no I/O and no clock.
"""
