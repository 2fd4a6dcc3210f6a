"""Base class of all screens: top bar, key bar, help, command palette and name."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.command import CommandPalette
from textual.events import ScreenResume
from textual.screen import Screen

from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.screens.help_screen import HelpScreen
from bcapscope.tui.screens.screen_commands import ScreenCommandProvider, all_commands
from bcapscope.tui.widgets.bars import KeyBar, TopBar
from bcapscope.tui.widgets.plain_containers import PlainContainer


class BaseScreen(Screen[None], PlainContainer):
    """A screen that the user can open; the method `content` yields the screen's widgets.

    `NAME` and `ABOUT` are the catalogue ids of the screen's name and description.
    """

    NAME: ClassVar[str]
    ABOUT: ClassVar[str]
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f1", "help", "shell.help"),
        Binding("ctrl+p", "palette", "shell.palette"),
        Binding("tab", "app.focus_next", "shell.next", show=False),
        Binding("shift+tab", "app.focus_previous", "shell.previous", show=False),
    ]

    def compose(self) -> ComposeResult:
        """Put the content between the bars; set the style classes for the size before the first layout."""
        classes = [name for width, name in self.HORIZONTAL_BREAKPOINTS or () if width <= self.app.size.width]
        self.set_class(True, *classes[-1:], update=False)
        yield TopBar()
        yield from self.content()
        yield KeyBar()

    def on_mount(self) -> None:
        """Freeze the mounted widgets for the garbage collector, because scanning them would delay keys."""
        self.call_after_refresh(gc.freeze)

    def on_screen_resume(self, event: ScreenResume) -> None:
        """Skip Textual's style update: each widget already has its styles, also after a change of theme."""
        event.refresh_styles = False

    def call_in_screen(self, function: Callable[..., object], *arguments: object) -> None:
        """Call a function in the screen's thread. Any thread may call this method, which does not wait."""
        self.call_later(function, *arguments)

    def content(self) -> ComposeResult:
        raise NotImplementedError

    def commands(self) -> Iterator[tuple[str, str, str]]:
        """Yield name, explanation and action of the palette's commands that have no key."""
        yield from ()

    async def action_palette(self) -> None:
        palette = CommandPalette(providers=[ScreenCommandProvider], placeholder=label("shell.palette.hint"))
        await self.app.push_screen(palette)

    async def action_help(self) -> None:
        keys = [
            (command.key, command.name, command.tip)
            for command in all_commands(self, app_of(self))
            if command.key
        ]
        await self.app.push_screen(HelpScreen(label(self.NAME), label(self.ABOUT), keys))
