"""What stands behind other widgets: blank, and drawn as cheaply as that can be."""

from __future__ import annotations

from textual.containers import Vertical
from textual.geometry import Region, Size
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import ContentSwitcher


class PlainContainer(Widget):
    """A container without border, padding and scroll bars; the widgets in it are all that is seen of it.

    Textual draws each line of a container although others cover it, which was a third of the time that a new
    size of the terminal takes. To be named behind another base: Textual takes styles from the first one only.
    """

    def render_lines(self, crop: Region) -> list[Strip]:
        """Draw one blank line, and have it stand for all."""
        blank = Strip.blank(crop.width, self.rich_style)
        for each in self.get_line_filters():
            blank = blank.apply_filter(each, self.background_colors[1])
        return [blank] * crop.height

    def _size_updated(
        self, size: Size, virtual_size: Size, container_size: Size, layout: bool = True
    ) -> bool:
        """Take a size as it was laid out; as it does not scroll, nothing has to be laid out again."""
        return super()._size_updated(size, virtual_size, container_size, layout=False)


class PlainVertical(Vertical, PlainContainer):
    """Widgets one below the other."""


class Switcher(ContentSwitcher, PlainContainer):
    """Widgets of which one is seen at a time."""
