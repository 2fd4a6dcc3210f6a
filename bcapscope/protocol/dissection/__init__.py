"""Explain frames to people: fields with their meanings, plausibility checks, and repair of damaged frames."""
