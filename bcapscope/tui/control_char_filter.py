"""The last line filter before the terminal: replaces every control character.

bcapscope escapes texts from the wire where it renders them. Textual's own widgets, however, show typed or
pasted text unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

from rich.cells import cell_len
from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter

_REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
_IDEOGRAPHIC_SPACE = "\u3000"
"""Python counts the ideographic space as not printable, but Japanese texts use it everywhere."""


class ControlCharFilter(LineFilter):
    """Replaces each character that is not visibly printable, after running all other line filters.

    `ControlCharFilter` runs the other filters itself. Textual splits and joins each line once per filter, so
    a single filter is faster.
    """

    def __init__(self, earlier_filters: Sequence[LineFilter] = ()) -> None:
        super().__init__()
        self.earlier_filters = tuple(earlier_filters)

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the segments of a line without control characters; printable segments stay unchanged."""
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
    """Replace each control character by as many columns as Textual counted for the character."""
    return "".join(
        char if char.isprintable() or char == _IDEOGRAPHIC_SPACE else _REPLACEMENT * cell_len(char)
        for char in text
    )
