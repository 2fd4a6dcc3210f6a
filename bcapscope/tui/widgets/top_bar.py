"""The bar above all screens: the present screen, the other screens, and the permanent status."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual.app import RenderResult

from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.click_bar import ClickBar


class TopBar(ClickBar):
    """Shows the screens with their keys, and `BcapApp.status` at the right; a click opens a screen."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"topbar--title", "topbar--here", "topbar--there"}

    def on_mount(self) -> None:
        self.watch(self.app, "status", self._show_status)

    def _show_status(self) -> None:
        self.refresh()

    def render(self) -> RenderResult:
        """Render the bar; if there is no room for screens and status, the status takes precedence."""
        app = app_of(self)
        status = Text.assemble(*((text, app.text_styles.get(ink, "")) for text, ink in app.status))
        left = Text(" bcapscope ", style=self.get_component_rich_style("topbar--title"), end="")
        for entry in app.screen_entries:
            kind = "topbar--here" if entry.mode == app.current_mode else "topbar--there"
            style = self.style_for(kind, f"app.switch_mode({entry.mode!r})")
            left.append(f" {entry.key.upper()} {label(entry.name)} ", style=style)
        space = self.size.width - left.cell_len - status.cell_len
        if space < 0:
            left.truncate(max(0, self.size.width - status.cell_len))
        return Text.assemble(left, " " * max(0, space), status, no_wrap=True, end="")
