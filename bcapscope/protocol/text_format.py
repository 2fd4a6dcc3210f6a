"""Formatting of numbers and text for people, shared by the whole program."""

from __future__ import annotations

import unicodedata

_FORMULA_STARTS = tuple("=+-@\t\r＝＋－＠")


def is_spreadsheet_formula(text: str) -> bool:
    """Return whether a spreadsheet would interpret a text as a formula. Japanese spreadsheets also accept the
    full-width forms of `=`, `+`, `-` and `@`.
    """
    return text.lstrip(" \u3000").startswith(_FORMULA_STARTS)


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun, such as `2 bytes`; the default plural is the noun with an s."""
    return f"{count} {noun}" if count == 1 else f"{count} {plural or noun + 's'}"


def shortened(text: str, most: int) -> str:
    """Cut a text after `most` characters. If characters were cut off, append an ellipsis."""
    return text if len(text) <= most else f"{text[:most]}…"


def display_width(text: str) -> int:
    """Return how many terminal columns a text takes: two for a wide character, none for a combining one."""
    if text.isascii():
        return len(text)
    spacing = [char for char in text if unicodedata.category(char) not in ("Mn", "Me")]
    return len(spacing) + sum(unicodedata.east_asian_width(char) in "WF" for char in spacing)
