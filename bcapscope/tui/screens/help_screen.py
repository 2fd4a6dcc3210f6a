"""The help dialog: description of a screen, and all keys of the screen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label

HelpKeys = list[tuple[str, str, str]]
"""For each key: its name as in the documentation, what the key does, and an explanation or ""."""


class HelpScreen(ModalScreen[None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,f1", "dismiss", "shell.close", key_display="esc"),
    ]

    def __init__(self, name: str, text: str, keys: HelpKeys) -> None:
        super().__init__()
        self._title, self._text, self._keys = name, text, keys

    def compose(self) -> ComposeResult:
        with VerticalScroll(id="help") as page:
            page.border_title = Text(label("shell.help.title", name=self._title)).markup
            page.border_subtitle = label("shell.close.hint")
            yield Static(Group(*self._parts()), id="help-text")

    def on_mount(self) -> None:
        self.query_one("#help").focus()

    def _parts(self) -> Iterator[RenderableType]:
        inks = app_of(self).text_styles
        for paragraph in self._text.split("\n"):
            yield Text(paragraph)
        yield Text(f"\n{label('shell.keys')}", style=inks["name"])
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")  # Japanese text has no spaces to break at
        for key, what, tip in self._keys:
            table.add_row(Text(key, style=inks["number"]), Text(what, style=inks["name"]), Text(tip))
        yield table
