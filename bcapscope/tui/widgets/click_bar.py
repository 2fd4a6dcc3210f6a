"""A line of texts, each of which runs an action when it is clicked."""

from __future__ import annotations

from rich.style import Style
from textual.reactive import var
from textual.widget import Widget


class ClickBar(Widget):
    """Base of the bars; a subclass renders pieces in the styles that `style_for` returns."""

    auto_links = var(False)
    """Off, since Textual would draw what can be clicked in its own colours."""

    def style_for(self, name: str, action: str) -> Style:
        """Return the style of a component class for a piece whose click runs `action`."""
        return self.get_component_rich_style(name) + Style(meta={"@click": action})
