"""Parse numbers that people type: ASCII digits only, with limits for length and value. Python's own functions
accept digits of every script, integers of 4,300 digits, and floats that overflow to infinity.
"""

from __future__ import annotations

import re

LONGEST_NUMBER = 40
"""Maximum length, in characters, of the text of a number. An integer of 64 bits needs 20 characters."""

_INTEGER = re.compile(r"[-+]?(?:[0-9]+|0[xX][0-9A-Fa-f]+)")
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def parse_integer(text: str, minimum: int, maximum: int) -> int | None:
    """Parse a decimal or 0x-prefixed integer; None if it is invalid or out of bounds."""
    text = text.strip()
    if len(text) > LONGEST_NUMBER or not _INTEGER.fullmatch(text):
        return None
    number = int(text, 16 if "x" in text.lower() else 10)
    return number if minimum <= number <= maximum else None


def parse_number(text: str, minimum: float, maximum: float) -> float | None:
    """Parse a decimal number, with or without exponent; None if it is invalid or out of bounds."""
    text = text.strip()
    if len(text) > LONGEST_NUMBER or not _NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if minimum <= number <= maximum else None
