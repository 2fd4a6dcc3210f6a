"""A line of texts; a click on a text runs the action of that text."""

from __future__ import annotations

from rich.style import Style
from textual.reactive import var
from textual.widget import Widget


class ClickBar(Widget):
    """Base class of the bars; a subclass renders its texts in the styles that `style_for` returns."""

    auto_links = var(False)
    """Textual's own link style is off, because it would draw clickable text in other colours."""

    def style_for(self, name: str, action: str) -> Style:
        """Return the style of a component class for a text whose click runs `action`."""
        return self.get_component_rich_style(name) + Style(meta={"@click": action})
