"""Frames taken apart for people: fields with their bytes and meanings, plausibility, repair of damaged
frames.
"""
