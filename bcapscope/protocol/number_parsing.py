"""Numbers as people type them: ASCII digits, no more characters than a number needs, within bounds.

Python reads digits of every script, integers of 4,300 digits and floats that become infinite. None of that
reaches arithmetic from here.
"""

from __future__ import annotations

import re

LONGEST_NUMBER = 40
"""Characters; an integer of 64 bits needs 20."""

_INTEGER = re.compile(r"[-+]?(?:[0-9]+|0[xX][0-9A-Fa-f]+)")
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def parse_integer(text: str, minimum: int, maximum: int) -> int | None:
    """Read an integer in decimals, or in hexadecimals behind 0x; None if it is none, or out of bounds."""
    text = text.strip()
    if len(text) > LONGEST_NUMBER or not _INTEGER.fullmatch(text):
        return None
    number = int(text, 16 if "x" in text.lower() else 10)
    return number if minimum <= number <= maximum else None


def parse_number(text: str, minimum: float, maximum: float) -> float | None:
    """Read a number in decimals, with an exponent or without; None if it is none, or out of bounds."""
    text = text.strip()
    if len(text) > LONGEST_NUMBER or not _NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if minimum <= number <= maximum else None
