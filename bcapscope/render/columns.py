"""Align text in columns, and wrap text; East Asian characters count as two columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from bcapscope.protocol.text_format import display_width

_WIDE = "\u1100-\u115f\u2e80-\ua4cf\uac00-\ud7a3\uf900-\ufaff\ufe30-\ufe6f\uff01-\uff60\uffe0-\uffe6"
"""East Asian characters that take two terminal columns.

Text may be wrapped before and after these characters.
"""

_CLOSING = "、。，．）」』】：；！？ーぁぃぅぇぉっゃゅょァィゥェォッャュョ"
"""Wide characters that must not begin a line."""

_WORDS = re.compile(f" *(?:[{_WIDE}][{_CLOSING}]*|[^ {_WIDE}]+[{_CLOSING}]*| +$)")
"""Matches the pieces between which a line may be wrapped: words and single wide characters, with the spaces
before them.
"""


def align_columns(rows: Sequence[Sequence[str]], alignments: str) -> Iterator[str]:
    """Yield rows of escaped text as lines in which each column is as wide as its widest cell.

    `alignments` has one character per column: ``>`` aligns the column to the right, ``<`` to the left.
    """
    widths = [max(map(display_width, cells), default=0) for cells in zip(*rows, strict=True)]
    for row in rows:
        cells = []
        for cell, width, side in zip(row, widths, alignments, strict=True):
            space = " " * (width - display_width(cell))
            cells.append(space + cell if side == ">" else cell + space)
        yield "  ".join(cells).rstrip()


def wrap_text(text: str, width: int) -> Iterator[str]:
    """Wrap text into lines of at most `width` columns, at spaces and beside wide characters.

    A word that is longer than `width` is not broken.
    """
    line = ""
    for piece in _WORDS.findall(text):
        if line and display_width(line) + display_width(piece) > width:
            yield line
            line = ""
        line += piece if line else piece.lstrip(" ")
    yield line
