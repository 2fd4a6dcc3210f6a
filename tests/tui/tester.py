"""Driving the Tester's screen in tests."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from textual.events import Paste
from textual.pilot import Pilot
from textual.widgets import Button, Input

from bcapscope.live.controller.halt_connection import HaltState
from bcapscope.messages import Language
from bcapscope.player.player_messages import PlayEnded
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.screens.tester_screen import TesterOptions, TesterScreen
from bcapscope.tui.tester.dialogs import ChoiceDialog
from bcapscope.tui.tester.result_view import ResultView
from bcapscope.tui.widgets.text_widgets import InkedText
from tests.tui.marks import strip_styles
from tests.tui.pilot import make, shown, until

COMMAND, RESULT = "#robot-forms .command", "#execute ResultView"
LONG = 20
"""Characters that nobody types."""

PLAYED = 100.0
"""Seconds that playing may take on a busy machine."""


def make_tester(folder: Path, host: str = "", port: int = 5007, *, japanese: bool = False) -> BcapApp:
    """Make the application with the Tester alone; everything it writes goes to `folder`."""
    start = TesterOptions(folder / "requests", folder / "log", host, port, profile="rc7")
    language = Language.JAPANESE if japanese else Language.ENGLISH
    spot = ScreenEntry("tester", "f2", "tester.name.screen", lambda: TesterScreen(start))
    return make(spot, language=language, settings=folder / "screen.yaml")


def screen(pilot: Pilot[None]) -> TesterScreen:
    """Return the Tester, whatever lies above it."""
    return next(each for each in pilot.app.screen_stack if isinstance(each, TesterScreen))


async def write(pilot: Pilot[None], text: str) -> None:
    """Type a text over what stands in the field that has the focus; paste a long one."""
    focused = pilot.app.focused
    assert isinstance(focused, Input), focused
    await pilot.press("end", "ctrl+u")
    if len(text) > LONG:
        pilot.app.post_message(Paste(text))
        await until(pilot, lambda: focused.value == text)
    else:
        await pilot.press(*text)
    assert focused.value == text


async def go(pilot: Pilot[None], selector: str, key: str = "tab") -> None:
    """Press a key until a widget of the screen above all has the focus."""
    wanted = pilot.app.screen.query_one(selector)
    for _ in range(80):
        if pilot.app.focused is wanted:
            return
        await pilot.press(key)
    raise AssertionError(f"{selector} cannot be reached by {key}; the focus is on {pilot.app.focused}")


async def focus(pilot: Pilot[None], selector: str) -> None:
    """Put the focus on a widget, as a click does, once it is in sight."""
    widget = screen(pilot).query_one(selector)
    await until(pilot, lambda: widget.focusable)
    widget.focus()
    await until(pilot, lambda: pilot.app.focused is widget)


async def connected(pilot: Pilot[None]) -> TesterScreen:
    """Connect as one does: Enter on the button that has the focus."""
    here = screen(pilot)
    await until(pilot, lambda: here.query_one("#host", Input).value)
    await pilot.press("enter")
    await ready(pilot)
    return here


async def ready(pilot: Pilot[None]) -> None:
    """Wait until it is connected, a command can be typed and HALT is at hand."""
    here = screen(pilot)
    await until(pilot, lambda: here.session.status.robot is not None)
    await until(pilot, lambda: here.halt_update.state is HaltState.READY)
    await until(pilot, lambda: pilot.app.focused is here.query_one(COMMAND))


async def add_gundam(pilot: Pilot[None]) -> None:
    """Add the robot of the pages; what the screen asks of it by itself has been answered then."""
    here = screen(pilot)
    await go(pilot, "#add-robot .name", "shift+tab")
    await write(pilot, "Gundam")
    await pilot.press("enter")
    added = here.query_one("#add-robot ResultView", ResultView)
    await until(pilot, lambda: added.record)
    assert [each.label for each in here.session.status.open_objects if each.kind is ObjectClass.ROBOT][
        -1
    ] == "Gundam"


async def errors_read(pilot: Pilot[None]) -> None:
    """Wait until what to do after an error tells which error it was."""

    def error_lines() -> list[str]:
        return [str(each.content) for each in pilot.app.screen.query("#errors").results(InkedText)]

    await until(pilot, lambda: any("0x8420405" in each for each in error_lines()))


def sight(pilot: Pilot[None]) -> str:
    """Return all that is in sight."""
    return shown(cast(BcapApp, pilot.app))


def result(pilot: Pilot[None], selector: str) -> str:
    """Return what a result shows."""
    return strip_styles(screen(pilot).query_one(selector, ResultView).text)


async def answered(pilot: Pilot[None], selector: str, begins: str) -> str:
    """Wait for a result and return it."""
    await until(pilot, lambda: result(pilot, selector).startswith(begins))
    return result(pilot, selector)


async def execute(pilot: Pilot[None], command: str, parameter: str = "") -> None:
    """Have a command of the robot executed; its end is not waited for."""
    await focus(pilot, COMMAND)
    await write(pilot, command)
    screen(pilot).query_one("#execute TypedValue .value", Input).value = parameter
    await pilot.press("enter")


async def executed(pilot: Pilot[None], command: str, parameter: str = "") -> str:
    """Have a command of the robot executed, and return its result."""
    shown_record = screen(pilot).query_one(RESULT, ResultView)
    before = shown_record.record
    await execute(pilot, command, parameter)
    await until(pilot, lambda: shown_record.record not in (None, before))
    return result(pilot, RESULT)


async def finish(pilot: Pilot[None]) -> None:
    """Quit as the user does, so that everything is let go."""
    await pilot.press("ctrl+q")
    await until(pilot, lambda: not screen(pilot).session.status.is_connected)


async def watched(pilot: Pilot[None], here: SlaveScreen) -> PlayEnded:
    """Wait for the end; where this machine was too slow for the mode, clear the error and play again."""

    def ended() -> PlayEnded | None:
        return here.playback.ended if here.playback is not None else None

    def is_asked() -> bool:
        return isinstance(pilot.app.screen, ChoiceDialog)

    for _ in range(12):
        await until(pilot, lambda: ended() or is_asked(), PLAYED)
        if is_asked():  # whether to clear it and play again, whether to go to the first set point
            choices = len(pilot.app.screen.query(Button))
            await pilot.press(*["right"] * (choices - 1), "enter")
            await until(pilot, lambda: not is_asked())
    result = ended()
    assert result is not None
    return result
