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

_REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
_IDEOGRAPHIC_SPACE = "\u3000"
"""The ideographic space is not printable by Unicode, yet Japanese texts are full of it."""


class ControlCharFilter(LineFilter):
    """Puts a replacement character for each that is not plainly visible, after all that other filters do.

    It stands for all of them, since Textual takes each line apart and puts it together again for each filter.
    """

    def __init__(self, earlier_filters: Sequence[LineFilter] = ()) -> None:
        """Take the filters that come before."""
        super().__init__()
        self.earlier_filters = tuple(earlier_filters)

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the segments of a line, those that are harmless as they are."""
        for each in self.earlier_filters:
            segments = each.apply(segments, background)
        if all(segment.text.isprintable() for segment in segments):
            return segments
        return [
            segment
            if segment.text.isprintable()
            else Segment(_replace_control_chars(segment.text), segment.style)
            for segment in segments
        ]


def _replace_control_chars(text: str) -> str:
    """Replace what a terminal would obey by as many columns as it was counted for."""
    return "".join(
        char if char.isprintable() or char == _IDEOGRAPHIC_SPACE else _REPLACEMENT * cell_len(char)
        for char in text
    )
