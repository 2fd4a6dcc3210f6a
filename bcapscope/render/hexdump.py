"""Hex dump: each line shows an offset, up to 16 bytes, and the same bytes as ASCII."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from bcapscope.render.color_palette import PLAIN, Palette

PER_LINE = 16  # bytes, by default

_BLANK_AFTER = 8  # after this many bytes, a line has two spaces instead of one
_ASCII = bytes(byte if 0x20 <= byte < 0x7F else ord(".") for byte in range(256)).decode("ascii")


class Highlight(NamedTuple):
    """A range of bytes, `stop` excluded, and the ANSI colour sequence for it."""

    start: int
    stop: int
    style: str


def hexdump(
    data: bytes,
    highlights: Sequence[Highlight] = (),
    palette: Palette = PLAIN,
    first: int = 0,
    per_line: int = PER_LINE,
) -> Iterator[str]:
    """Yield the lines of a hex dump. Where `highlights` overlap, the last highlight sets the colour.

    Offsets are decimal, as in field trees and problems, and start at `first`.
    """
    width = max(6, len(str(first + len(data))))
    pending = list(highlights)[::-1]
    active: list[Highlight] = []
    for at in range(0, len(data), per_line):
        row = data[at : at + per_line]
        start = first + at
        while pending and pending[-1].start < start + len(row):
            active.append(pending.pop())
        active = [each for each in active if each.stop > start]
        caption = f"{palette.dim}{start:>{width}}{palette.reset}"
        yield f"{caption}  {_line(row, _styles(row, start, active), palette.reset, per_line)}"


def _styles(row: bytes, start: int, active: list[Highlight]) -> list[str]:
    styles = [""] * len(row)
    for each in active:
        for index in range(max(0, each.start - start), min(len(row), each.stop - start)):
            styles[index] = each.style
    return styles


def _line(row: bytes, styles: list[str], reset: str, per_line: int) -> str:
    plain = row[:_BLANK_AFTER].hex(" ") + (
        "  " + row[_BLANK_AFTER:].hex(" ") if len(row) > _BLANK_AFTER else ""
    )
    padding = " " * (3 * per_line - (per_line <= _BLANK_AFTER) - len(plain))
    if not any(styles):
        return f"{plain}{padding}  {''.join(_ASCII[byte] for byte in row)}"
    shown, letters = [], []
    for style, run in groupby(range(len(row)), lambda index: styles[index]):
        indexes = list(run)
        # A space gets the style of the two bytes around it if both have the same style, otherwise no style.
        pairs = "".join(f"{_blanks(index)}{row[index]:02x}" for index in indexes).lstrip()
        word = "".join(_ASCII[row[index]] for index in indexes)
        shown.append(_blanks(indexes[0]) + _styled(pairs, style, reset))
        letters.append(_styled(word, style, reset))
    return f"{''.join(shown)}{padding}  {''.join(letters)}"


def _blanks(index: int) -> str:
    return "" if index == 0 else "  " if index == _BLANK_AFTER else " "


def _styled(text: str, style: str, reset: str) -> str:
    return f"{style}{text}{reset}" if style else text
