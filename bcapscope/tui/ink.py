"""Ink marks: control characters that set the style of the text on the screen.

An ink mark applies to the text after it, up to the next ink mark. Renderers mark styles with the codes of a
`Palette`; the codes of the palette `INK` are ink marks. Text from the wire cannot contain ink marks, because
bcapscope escapes the control characters in text from the wire.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields

from rich.segment import Segment
from rich.style import Style
from rich.text import Text

from bcapscope.render.color_palette import Palette

INK = Palette(
    number="\x01", name="\x02", hex="\x03", problem="\x04", good="\x05", bad="\x06", dim="\x07", reset="\x0e"
)
LIT, CURSOR = "\x0f", "\x10"
"""Ink marks of the byte view: for the bytes of the selected field, and for the byte under the cursor."""

_STYLE_MARKS = re.compile("[\x01-\x07\x0e-\x10]")
STYLE_NAMES: Mapping[str, str] = {
    **{getattr(INK, each.name): each.name for each in fields(INK) if each.name != "reset"},
    LIT: "lit",
    CURSOR: "cursor",
}
"""Style name of each ink mark except `INK.reset`, which ends a style."""

Styles = Mapping[str, Style]  # by the names in `STYLE_NAMES`


def styled_pieces(text: str) -> Iterator[tuple[str, str]]:
    """Split a rendered line into pieces of one style: yield the style's name ("" for none) and the text."""
    name, at = "", 0
    for mark in _STYLE_MARKS.finditer(text):
        if mark.start() > at:
            yield name, text[at : mark.start()]
        name, at = STYLE_NAMES.get(mark.group(), ""), mark.end()
    if at < len(text):
        yield name, text[at:]


def styled_segments(text: str, styles: Styles) -> list[Segment]:
    return [Segment(piece, styles.get(name)) for name, piece in styled_pieces(text)]


def styled_text(text: str, styles: Styles) -> Text:
    made = Text()
    for name, piece in styled_pieces(text):
        made.append(piece, styles.get(name))
    return made
