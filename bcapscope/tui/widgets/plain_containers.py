"""Containers without decoration that Textual draws cheaply."""

from __future__ import annotations

from textual.containers import Vertical
from textual.geometry import Region
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import ContentSwitcher


class PlainContainer(Widget):
    """A container without border, padding and scroll bars, so that all its lines are blank.

    Textual draws each line of an ordinary container, even if children hide the line. In a measurement,
    drawing these hidden lines took a third of the time that the screen needed after a resize of the terminal.
    A subclass must name `PlainContainer` after another base class, because Textual takes styles only from the
    first base class.
    """

    def render_lines(self, crop: Region) -> list[Strip]:
        blank = Strip.blank(crop.width, self.rich_style)
        for each in self.get_line_filters():
            blank = blank.apply_filter(each, self.background_colors[1])
        return [blank] * crop.height


class PlainVertical(Vertical, PlainContainer):
    """Stacks widgets vertically."""


class Switcher(ContentSwitcher, PlainContainer):
    """Shows one of its children at a time."""
