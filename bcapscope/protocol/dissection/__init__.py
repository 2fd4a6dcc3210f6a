"""Frames dissected for people: fields with bytes and meanings, plausibility, repair of damaged frames."""
