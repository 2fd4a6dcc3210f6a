"""Pictures of the Tester's screens in both themes; ``pytest --golden-write`` makes them anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import Button, Input

from bcapscope.live.controller import history_recorder
from bcapscope.live.controller.halt_connection import HaltState
from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.live.controller.reply_monitor import ReplyMonitor
from bcapscope.tui.app import BcapApp
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.tester.form_widgets import ChoiceRow, TickBox
from tests.cli.run import CAPTURES
from tests.tui.pilot import drive, picture, until
from tests.tui.test_pictures import PICTURES
from tests.tui.tester import (
    add_gundam,
    answered,
    connected,
    errors_read,
    executed,
    finish,
    focus,
    go,
    make_tester,
    screen,
    write,
)

SIZE, LARGE = (80, 24), (160, 44)
NEW_YEAR, SECOND = 1_767_225_600_000_000_000, 1_000_000_000
LIMIT = 280.0
"""Seconds for a session that is photographed; a busy machine draws slowly."""
POINT = "12.42261, 60.36108, 17.63232, 35.81433, 20.42798, 23.94879"


@pytest.fixture
def _same_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each call take as long as all others, and begin a second after the one before.

    The controller was heard just now, however long a picture takes.
    """

    def tamed(**fields: Any) -> HistoryRecord:
        return HistoryRecord(**{**fields, "took": 1_234_000, "began": NEW_YEAR + fields["number"] * SECOND})

    monkeypatch.setattr(history_recorder, "HistoryRecord", tamed)
    monkeypatch.setattr(ReplyMonitor, "silence", lambda self, now: 0)
    monkeypatch.setattr(ReplyMonitor, "is_reply_overdue", lambda self, now: False)


class Album:
    """Takes pictures of one run in all themes, and compares them with those that are kept.

    What differs is laid into `folder`.
    """

    def __init__(self, app: BcapApp, folder: Path, write: bool) -> None:
        self._app, self._folder, self._write = app, folder, write
        self._others: list[str] = []

    async def take(self, pilot: Pilot[None], name: str) -> None:
        """Take a picture in each theme, once HALT is at hand and no button is lit by its push."""
        here = screen(pilot)
        await until(pilot, lambda: here.halt_update.state is HaltState.READY)
        await until(pilot, lambda: not pilot.app.screen.query("Button.-active"))
        await until(pilot, lambda: not here.query("Button.-active"))
        app = self._app
        for theme in (app.theme, "light" if app.theme == "dark" else "dark"):
            app.theme = theme
            app.clear_notifications()
            await pilot.pause()
            self._compare(f"{name}-{theme}", picture(app))

    def _compare(self, name: str, taken: bytes) -> None:
        path = PICTURES / f"{name}.svg"
        if self._write:
            path.write_bytes(taken)
        if not path.exists() or path.read_bytes() != taken:
            other = self._folder / path.name
            other.write_bytes(taken)
            self._others.append(str(other))

    def check(self) -> None:
        """Tell all that are not as they were."""
        assert self._others == [], f"these differ from those in {PICTURES}; --golden-write keeps them instead"


async def begin(pilot: Pilot[None]) -> None:
    """Connect, add the robot of the pages, and start RobSlave; over TCP, where no serials go into retries."""
    screen(pilot).query_one("#udp", TickBox).value = False
    here = await connected(pilot)
    here.query_one("#port", Input).value = "5007"
    await add_gundam(pilot)
    await pilot.press("ctrl+b")
    await until(pilot, lambda: any(each.label == "RobSlave" for each in here.session.status.open_objects))


@pytest.mark.timeout(300)
@pytest.mark.usefixtures("_same_times")
def test_the_window_of_the_pages(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    app = make_tester(tmp_path)
    album = Album(app, tmp_path, request.config.getoption("--golden-write"))

    async def act(pilot: Pilot[None]) -> None:
        await begin(pilot)
        await executed(pilot, "slvChangeMode", "2")
        await executed(pilot, "slvMove", POINT)
        await focus(pilot, "#sent HexView")
        await pilot.press("end", *["left"] * 20)
        await album.take(pilot, "tester")
        await finish(pilot)

    drive(app, act, LARGE, LIMIT)
    album.check()


@pytest.mark.deep
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("_same_times")
def test_each_of_its_parts(
    tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = make_tester(tmp_path)
    album = Album(app, tmp_path, request.config.getoption("--golden-write"))

    async def act(pilot: Pilot[None]) -> None:
        await begin(pilot)
        await executed(pilot, "slvChangeMode", "2")
        await executed(pilot, "slvMove", POINT)
        await album.take(pilot, "tester-robot")
        monkeypatch.chdir(CAPTURES)  # so that the path of the file is the same everywhere
        for part in (variable, task, function, history, recovery, slave_mode):
            await part(pilot, album)
        await finish(pilot)

    drive(app, act, SIZE, LIMIT)
    album.check()


async def variable(pilot: Pilot[None], album: Album) -> None:
    here = screen(pilot)
    await executed(pilot, "slvChangeMode", "0")
    here.query_one("#tabs", ChoiceRow).chosen = "variable"
    await focus(pilot, "#variable .name")
    await write(pilot, "I5")
    await pilot.press("enter")
    await until(pilot, lambda: here.session.status.open_objects[-1].label == "I5")
    await go(pilot, "#variable .value")
    await write(pilot, "42")
    await pilot.press("enter")
    await answered(pilot, "#variable ResultView", "(EMPTY)")
    await pilot.press("tab", "enter")
    await answered(pilot, "#variable ResultView", "42")
    await album.take(pilot, "tester-variable")


async def task(pilot: Pilot[None], album: Album) -> None:
    screen(pilot).query_one("#tabs", ChoiceRow).chosen = "task"
    await focus(pilot, "#task #state")
    await pilot.press("enter")
    await answered(pilot, "#task-result", "3")
    buttons = screen(pilot).query("#task-box Button")
    assert all(button.region.right <= SIZE[0] and button.region.width for button in buttons)
    await album.take(pilot, "tester-task")


async def function(pilot: Pilot[None], album: Album) -> None:
    screen(pilot).query_one("#tabs", ChoiceRow).chosen = "function"
    await focus(pilot, "#choose-function")
    await pilot.press("enter")
    await pilot.press(*"robot_move", "enter")
    await until(pilot, lambda: screen(pilot).query("#function #field2"))
    await until(pilot, lambda: pilot.app.focused is screen(pilot).query_one("#function #field0"))
    await album.take(pilot, "tester-function")


async def history(pilot: Pilot[None], album: Album) -> None:
    screen(pilot).query_one("#view", ChoiceRow).chosen = "history"
    await focus(pilot, "HistoryLines")
    await album.take(pilot, "tester-history")


async def recovery(pilot: Pilot[None], album: Album) -> None:
    here = screen(pilot)
    here.query_one("#tabs", ChoiceRow).chosen = "robot"
    await executed(pilot, "slvChangeMode", "2")
    await executed(pilot, "slvMove", POINT)
    for _ in range(2):  # the error is the answer to the next set point
        await executed(pilot, "slvMove", f"90{POINT[8:]}")
    await until(pilot, lambda: here.session.status.slave_mode == 0)
    await pilot.press("f7")
    await errors_read(pilot)
    here.query_one("#left").scroll_home(animate=False)
    await album.take(pilot, "tester-recovery")
    await pilot.press("escape")


async def slave_mode(pilot: Pilot[None], album: Album) -> None:
    await pilot.press("f9")
    await until(pilot, lambda: isinstance(pilot.app.screen, SlaveScreen))
    await until(pilot, lambda: isinstance(pilot.app.focused, Input))
    await write(pilot, "swing-joints.csv")
    start = pilot.app.screen.query_one("#start", Button)
    await until(pilot, lambda: not start.disabled)
    await album.take(pilot, "slave-mode-preflight")
    await pilot.press("escape")
