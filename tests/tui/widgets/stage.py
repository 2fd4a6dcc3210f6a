"""A screen with one widget on it."""

from __future__ import annotations

from collections.abc import Callable

from textual.app import ComposeResult
from textual.pilot import Pilot
from textual.widget import Widget

from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.screens.base_screen import BaseScreen
from tests.tui.pilot import Act, drive, make


def on_stage(widget: Callable[[], Widget], act: Act, size: tuple[int, int] = (80, 24)) -> None:
    """Show a widget and act."""

    class Stage(BaseScreen):
        NAME = "traffic"
        ABOUT = "shell.help.tip"

        def content(self) -> ComposeResult:
            made = widget()
            made.styles.height = "1fr"
            yield made

    drive(make(ScreenEntry("stage", "f3", "traffic", Stage)), act, size)


def scope(pilot: Pilot[None]) -> BcapApp:
    """Return the application."""
    assert isinstance(pilot.app, BcapApp)
    return pilot.app
