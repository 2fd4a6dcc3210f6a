"""HALT: one key, whatever is on the screen."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from textual.command import CommandPalette
from textual.drivers.headless_driver import HeadlessDriver
from textual.events import Key
from textual.pilot import Pilot
from textual.screen import Screen
from textual.widgets import Select

from bcapscope.tui.screens.base_screen import HelpScreen, Prompt
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.screens.tester_screen import TesterScreen as Window
from bcapscope.tui.terminal import HALT_KEYS, make_halt_driver
from bcapscope.tui.tester.dialogs import ArmDialog, ChoiceDialog, RecoveryDialog
from bcapscope.tui.tester.pickers import FilePicker, ListPicker
from tests.tui.pilot import drive, until
from tests.tui.tester import focus, make_tester

Open = Callable[[Pilot[None]], Awaitable[None]]


def keys(*pressed: str) -> Open:
    async def open_it(pilot: Pilot[None]) -> None:
        await pilot.press(*pressed)

    return open_it


def put(make: Callable[[], Screen[None]]) -> Open:
    async def open_it(pilot: Pilot[None]) -> None:
        pilot.app.push_screen(make())

    return open_it


async def catalogue(pilot: Pilot[None]) -> None:
    await focus(pilot, "#robot-forms .command")
    await pilot.press("f4")


async def functions(pilot: Pilot[None]) -> None:
    await focus(pilot, "#tabs")
    await pilot.press("right", "right", "right")
    await focus(pilot, "#choose-function")
    await pilot.press("enter")


async def list_of_types(pilot: Pilot[None]) -> None:
    await focus(pilot, "#execute .type")
    await pilot.press("enter")
    assert pilot.app.screen.query_one("#execute .type", Select).expanded


PLACES: tuple[tuple[Open, type[object]], ...] = (
    (keys(), Window),
    (list_of_types, Window),
    (keys("f1"), HelpScreen),
    (keys("ctrl+p"), CommandPalette),
    (keys("f7"), RecoveryDialog),
    (keys("f9"), SlaveScreen),
    (keys("f9", "ctrl+o"), FilePicker),
    (keys("f9", "ctrl+p"), CommandPalette),
    (catalogue, ListPicker),
    (functions, ListPicker),
    (put(lambda: ArmDialog([])), ArmDialog),  # type: ignore[arg-type, return-value]  # it answers
    (put(lambda: ChoiceDialog([], ("no", "yes"))), ChoiceDialog),  # type: ignore[arg-type, return-value]
    (put(lambda: Prompt("", "")), Prompt),  # type: ignore[arg-type, return-value]
)


@pytest.mark.timeout(240)
def test_each_key_halts_whatever_is_open(tmp_path: Path) -> None:
    halted: list[str] = []

    def halt() -> bool:
        halted.append("")
        return True

    async def act(pilot: Pilot[None]) -> None:
        app.add_halt_callback(halt)
        below = len(app.screen_stack)
        for opened, what in PLACES:
            halted.clear()
            await opened(pilot)
            await until(pilot, lambda what=what: isinstance(app.screen, what))  # type: ignore[misc]  # bound now
            for number, key in enumerate(HALT_KEYS, 1):
                await pilot.press(key)
                assert len(halted) == number, (what, key)
            assert isinstance(app.screen, what)
            while len(app.screen_stack) > below:
                await app.pop_screen()

    app = make_tester(tmp_path, "127.0.0.1", 9)
    drive(app, act, limit=200.0)


def test_the_driver_halts_before_the_event_loop_knows() -> None:
    pressed = threading.Event()
    passed: list[object] = []

    class Terminal(HeadlessDriver):
        def process_message(self, message: object) -> None:
            passed.append(message)

    driver = object.__new__(make_halt_driver(Terminal, pressed.set))
    driver.process_message(Key("a", "a"))
    assert not pressed.is_set()
    driver.process_message(Key("f12", None))
    assert pressed.is_set()
    assert len(passed) == 2


def test_a_key_that_the_driver_has_seen_halts_once(tmp_path: Path) -> None:
    """The key comes to the screen as well, which says so, and would halt where no driver reads keys."""
    halted: list[str] = []

    def halt() -> bool:
        halted.append("")
        return True

    async def act(pilot: Pilot[None]) -> None:
        app.add_halt_callback(halt)
        driver = app._driver
        assert driver is not None
        driver.process_message(Key("f12", None))
        await until(pilot, lambda: len(app._notifications) == 1)
        assert len(halted) == 1

    app = make_tester(tmp_path, "127.0.0.1", 9)
    drive(app, act)


def test_a_terminal_that_has_hung_up_is_not_taken_again() -> None:
    done: list[str] = []

    class Terminal(HeadlessDriver):
        def suspend_application_mode(self) -> None:
            done.append("suspend")

        def _sigcont_application(self, *arguments: object) -> None:
            done.append("resume")

    master, slave = os.openpty()
    driver: Any = object.__new__(make_halt_driver(Terminal, lambda: None))
    vars(driver).update(fileno=slave, _auto_restart=True, _must_signal_resume=True)
    for expected, asked in ((["resume"], True), (["suspend", "resume"], False)):
        vars(driver)["_must_signal_resume"] = asked
        driver._sigcont_application()
        assert done == expected
        done.clear()
    os.close(master)
    driver._sigcont_application()
    assert not done
    os.close(slave)


def test_halt_while_the_screen_hangs(tmp_path: Path) -> None:
    """The thread that reads the keys does not wait for the event loop."""
    halted = threading.Event()

    def halt() -> bool:
        halted.set()
        return True

    async def act(pilot: Pilot[None]) -> None:
        app.add_halt_callback(halt)
        driver = make_halt_driver(HeadlessDriver, app.halt)(app)
        loop = asyncio.get_running_loop()
        read = loop.run_in_executor(None, driver.process_message, Key("f12", None))
        assert halted.wait(10)  # which holds up the event loop meanwhile
        await read

    app = make_tester(tmp_path, "127.0.0.1", 9)
    drive(app, act)
