"""Colours of rendered lines: one character before a piece of text, which becomes a style of the theme.

Renderers put the sequences of a `Palette` before pieces of text. Here each is a control character below a
space, which no escaped text from the wire can hold, so that nothing a peer sends is ever taken for a style.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType

from rich.segment import Segment
from rich.style import Style
from rich.text import Text

from bcapscope.render.color_palette import Palette

INK = Palette(
    number="\x01", name="\x02", hex="\x03", problem="\x04", good="\x05", bad="\x06", dim="\x07", reset="\x0e"
)
"""The palette for everything that a widget shows."""

LIT, CURSOR = "\x0f", "\x10"
"""Before bytes that are lit because the cursor is on them in the other view; before the one that it is on."""

_STYLE_MARKS = re.compile("[\x01-\x07\x0e-\x10]")
_STYLE_NAMES: Mapping[str, str] = MappingProxyType(
    {
        INK.number: "number",
        INK.name: "name",
        INK.hex: "hex",
        INK.problem: "problem",
        INK.good: "good",
        INK.bad: "bad",
        INK.dim: "dim",
        LIT: "lit",
        CURSOR: "cursor",
    }
)

Styles = Mapping[str, Style]
"""A style for each name that `style_names` lists."""


def style_names() -> tuple[str, ...]:
    """Name the styles that a theme gives."""
    return tuple(_STYLE_NAMES.values())


def styled_pieces(text: str) -> Iterator[tuple[str, str]]:
    """Take a rendered line apart: names of styles, "" for none, each with its text."""
    name, at = "", 0
    for mark in _STYLE_MARKS.finditer(text):
        if mark.start() > at:
            yield name, text[at : mark.start()]
        name, at = _STYLE_NAMES.get(mark.group(), ""), mark.end()
    if at < len(text):
        yield name, text[at:]


def styled_segments(text: str, styles: Styles) -> list[Segment]:
    """Make segments of a rendered line."""
    return [Segment(piece, styles.get(name)) for name, piece in styled_pieces(text)]


def styled_text(text: str, styles: Styles) -> Text:
    """Make a text of a rendered line, or of several."""
    made = Text()
    for name, piece in styled_pieces(text):
        made.append(piece, styles.get(name))
    return made


def strip_styles(text: str) -> str:
    """Leave the marks out."""
    return _STYLE_MARKS.sub("", text)
