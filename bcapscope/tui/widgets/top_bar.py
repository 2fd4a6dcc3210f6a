"""The bar above all screens: the present screen, the others, and the permanent status."""

from __future__ import annotations

from rich.style import Style
from rich.text import Text
from textual.app import RenderResult
from textual.events import Click
from textual.widget import Widget

from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label


class TopBar(Widget):
    """Shows the screens with their keys, and `BcapApp.status` at the right.

    A click on a name opens that screen.
    """

    COMPONENT_CLASSES = {"topbar--title", "topbar--here", "topbar--there"}  # noqa: RUF012 - as Textual has it

    def on_mount(self) -> None:
        self.watch(self.app, "status", self._show_status)

    def _show_status(self) -> None:
        self.refresh()

    def render(self) -> RenderResult:
        """Render the bar; the status takes precedence if there is no room for both."""
        app = app_of(self)
        status = Text.assemble(*((text, app.text_styles.get(ink, "")) for text, ink in app.status))
        left = Text(" bcapscope ", style=self.get_component_rich_style("topbar--title"), end="")
        for mode, text in self._screen_labels():
            left.append(text, style=self._style(mode))
        space = self.size.width - left.cell_len - status.cell_len
        if space < 0:
            left.truncate(max(0, self.size.width - status.cell_len))
        return Text.assemble(left, " " * max(0, space), status, no_wrap=True, end="")

    def _style(self, mode: str) -> Style:
        here = mode == self.app.current_mode
        return self.get_component_rich_style("topbar--here" if here else "topbar--there")

    def _screen_labels(self) -> list[tuple[str, str]]:
        return [
            (spot.mode, f" {spot.key.upper()} {label(spot.name)} ") for spot in app_of(self).screen_entries
        ]

    async def on_click(self, event: Click) -> None:
        at = len(" bcapscope ")
        for mode, text in self._screen_labels():
            width = Text(text).cell_len
            if at <= event.x < at + width and mode != self.app.current_mode:
                await self.app.switch_mode(mode)
            at += width
