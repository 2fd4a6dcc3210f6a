"""The last thing between a widget and the terminal: nothing passes that a terminal would obey.

Texts from the wire are escaped where they are rendered. What is typed or pasted is shown by widgets that are
not ours, and they show it as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

from rich.cells import cell_len
from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter

_INSTEAD = "\N{REPLACEMENT CHARACTER}"
_BLANK = "\u3000"
"""The ideographic space is not printable by Unicode, yet Japanese texts are full of it."""


class Harmless(LineFilter):
    """Puts a replacement character for each that is not plainly visible, after all that other filters do.

    It stands for all of them, since Textual takes each line apart and puts it together again for each filter.
    """

    def __init__(self, before: Sequence[LineFilter] = ()) -> None:
        """Take the filters that come before."""
        super().__init__()
        self.before = tuple(before)

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the segments of a line, those that are harmless as they are."""
        for each in self.before:
            segments = each.apply(segments, background)
        if all(segment.text.isprintable() for segment in segments):
            return segments
        return [
            segment if segment.text.isprintable() else Segment(_cleaned(segment.text), segment.style)
            for segment in segments
        ]


def _cleaned(text: str) -> str:
    """Replace what a terminal would obey by as many columns as it was counted for."""
    return "".join(
        char if char.isprintable() or char == _BLANK else _INSTEAD * cell_len(char) for char in text
    )
