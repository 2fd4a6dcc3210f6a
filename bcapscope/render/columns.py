"""Align text in columns, and wrap text; East Asian characters count as two columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from bcapscope.protocol.text_format import display_width

_WIDE = "\u1100-\u115f\u2e80-\ua4cf\uac00-\ud7a3\uf900-\ufaff\ufe30-\ufe6f\uff01-\uff60\uffe0-\uffe6"
"""Ranges of East Asian characters that are two terminal columns wide. A line may be wrapped before or after
such a character.
"""

_CLOSING = "、。，．）」』】：；！？ーぁぃぅぇぉっゃゅょァィゥェォッャュョ"  # must not begin a line

_COLORS = re.compile(r"\x1b\[[0-9;]*m")
_PIECES = re.compile(r"\x1b\[[0-9;]*m| +|[^ \x1b]+")
_INDENT = " " * 7
_NARROWEST_ROW = 40

_WORDS = re.compile(f" *(?:[{_WIDE}][{_CLOSING}]*|[^ {_WIDE}]+[{_CLOSING}]*| +$)")
"""Matches a piece of a line: one word or one wide character, with the spaces before it, and the characters of
`_CLOSING` after it. A line may be wrapped between two such pieces.
"""


def align_columns(rows: Sequence[Sequence[str]], alignments: str) -> Iterator[str]:
    """Yield rows of escaped text as lines. `alignments` has ``>`` (right) or ``<`` (left) for each column."""
    widths = [max(map(display_width, cells), default=0) for cells in zip(*rows, strict=True)]
    for row in rows:
        cells = []
        for cell, width, side in zip(row, widths, alignments, strict=True):
            space = " " * (width - display_width(cell))
            cells.append(space + cell if side == ">" else cell + space)
        yield "  ".join(cells).rstrip()


def fit_line(line: str, width: int) -> str:
    if display_width(line) <= width:
        return line
    fitted = _prefix(line, width - 1)
    return f"{fitted}…"


def fold_line(line: str, width: int) -> str:
    """Break a line into rows, and indent all rows after the first. The line may contain colour sequences."""
    if width < _NARROWEST_ROW or display_width(_COLORS.sub("", line)) <= width:
        return line
    rows: list[str] = []
    row, room = "", width
    for piece in _PIECES.findall(line):
        rest = piece
        while rest and not _COLORS.fullmatch(rest) and display_width(rest) > room:
            if room == (width - len(_INDENT) if rows else width):  # break a word that is too long for a row
                start = _prefix(rest, room)
                row, rest = row + start, rest[len(start) :]
            rows.append(row)
            row, room = _INDENT, width - len(_INDENT)
            rest = rest.lstrip(" ")
        row += rest
        room -= 0 if _COLORS.fullmatch(rest) else display_width(rest)
    return "\n".join(each.rstrip(" ") for each in (*rows, row))


def _prefix(text: str, width: int) -> str:
    size = 1
    while size < len(text) and display_width(text[: size + 1]) <= width:
        size += 1
    return text[:size]


def wrap_text(text: str, width: int) -> Iterator[str]:
    """Wrap text at spaces and beside wide characters. A word that is longer than `width` stays whole."""
    line = ""
    for piece in _WORDS.findall(text):
        if line and display_width(line) + display_width(piece) > width:
            yield line
            line = ""
        line += piece if line else piece.lstrip(" ")
    yield line
