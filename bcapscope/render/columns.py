"""Text in columns."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator, Sequence


def display_width(text: str) -> int:
    """Count the columns that a terminal gives to `text`: two for wide characters, none for combining ones."""
    return sum(
        0 if unicodedata.combining(char) else 2 if unicodedata.east_asian_width(char) in "WF" else 1
        for char in text
    )


def columns(rows: Sequence[Sequence[str]], right: str) -> Iterator[str]:
    """Write rows with each column as wide as its widest cell.

    Args:
        rows: all with the same number of cells; nothing in them that a terminal would obey.
        right: for each column ``>`` to set it to the right, ``<`` to the left; the last is not filled up.
    """
    widths = [max(map(display_width, cells), default=0) for cells in zip(*rows, strict=True)]
    for row in rows:
        cells = []
        for cell, width, side in zip(row, widths, right, strict=True):
            space = " " * (width - display_width(cell))
            cells.append(space + cell if side == ">" else cell + space)
        yield "  ".join(cells).rstrip()


def wrapped(text: str, width: int) -> Iterator[str]:
    """Break text at spaces into lines of at most `width` columns; longer words stay whole."""
    line = ""
    for word in text.split(" "):
        if line and display_width(line) + 1 + display_width(word) > width:
            yield line
            line = word
        else:
            line = f"{line} {word}" if line else word
    yield line
