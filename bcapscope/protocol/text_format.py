"""How numbers and texts are put for people, the same everywhere."""

from __future__ import annotations

import unicodedata

_FORMULA_STARTS = tuple("=+-@\t\r＝＋－＠")


def is_spreadsheet_formula(text: str) -> bool:
    """Tell whether spreadsheets take a text for a formula; those in Japan take the wide signs as well."""
    return text.lstrip(" \u3000").startswith(_FORMULA_STARTS)


def counted(count: int, noun: str, plural: str = "") -> str:
    """Write a number with its noun, whose plural takes an s unless told."""
    return f"{count} {noun}" if count == 1 else f"{count} {plural or noun + 's'}"


def shortened(text: str, most: int) -> str:
    """Return a text in at most `most` characters, and an ellipsis where it is cut."""
    return text if len(text) <= most else f"{text[:most]}…"


def display_width(text: str) -> int:
    """Count the columns that a terminal gives to `text`: two for wide characters, none for combining ones."""
    if text.isascii():
        return len(text)
    return sum(
        0
        if unicodedata.category(char) in ("Mn", "Me")
        else 2
        if unicodedata.east_asian_width(char) in "WF"
        else 1
        for char in text
    )
