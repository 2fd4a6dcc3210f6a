"""Text in columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from bcapscope.protocol.text_format import display_width

_WIDE = "\u1100-\u115f\u2e80-\ua4cf\uac00-\ud7a3\uf900-\ufaff\ufe30-\ufe6f\uff01-\uff60\uffe0-\uffe6"
"""Characters of East Asian scripts that a terminal gives two columns to, and that text is broken beside."""

_CLOSING = "、。，．）」』】：；！？ーぁぃぅぇぉっゃゅょァィゥェォッャュョ"
"""Wide characters that no line begins with."""

_WORDS = re.compile(f" *(?:[{_WIDE}][{_CLOSING}]*|[^ {_WIDE}]+[{_CLOSING}]*| +$)")
"""What lines are made of: words and single wide characters, each with the spaces before it."""


def align_columns(rows: Sequence[Sequence[str]], alignments: str) -> Iterator[str]:
    """Write rows of escaped text with each column as wide as its widest cell.

    `alignments` has ``>`` for a column set to the right, ``<`` for one set to the left.
    """
    widths = [max(map(display_width, cells), default=0) for cells in zip(*rows, strict=True)]
    for row in rows:
        cells = []
        for cell, width, side in zip(row, widths, alignments, strict=True):
            space = " " * (width - display_width(cell))
            cells.append(space + cell if side == ">" else cell + space)
        yield "  ".join(cells).rstrip()


def wrap_text(text: str, width: int) -> Iterator[str]:
    """Break text into lines of at most `width` columns: at spaces, and beside wide characters. Long words
    stay whole.
    """
    line = ""
    for piece in _WORDS.findall(text):
        if line and display_width(line) + display_width(piece) > width:
            yield line
            line = ""
        line += piece if line else piece.lstrip(" ")
    yield line
