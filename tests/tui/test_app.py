"""The frame around all screens: help, commands, themes, settings, how it ends."""

from __future__ import annotations

import asyncio
import gc
import os
import pty
import select
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path

import pytest
from textual.app import ComposeResult
from textual.pilot import Pilot
from textual.widgets import Input, Static

from bcapscope.messages import Language
from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.screens.base_screen import BaseScreen, HelpScreen, all_commands
from bcapscope.tui.settings import read_settings
from bcapscope.tui.widgets.bars import TopBar
from tests.cli.run import CAPTURES
from tests.tui.pilot import drive, make, shown, until


class _Here(BaseScreen):
    NAME = "traffic"
    ABOUT = "shell.help.tip"

    def content(self) -> ComposeResult:
        yield Input()
        yield Static("here")


class _There(BaseScreen):
    NAME = "shell.keys"
    ABOUT = "shell.help.tip"

    def content(self) -> ComposeResult:
        yield Static("there")


def app(settings: Path | None = None, language: Language = Language.ENGLISH) -> BcapApp:
    spots = (ScreenEntry("here", "f2", "traffic", _Here), ScreenEntry("there", "f3", "shell.keys", _There))
    return make(*spots, settings=settings, language=language)


def test_keys_lead_from_screen_to_screen() -> None:
    async def act(pilot: Pilot[None]) -> None:
        assert "here" in shown(made)
        await pilot.press("f3")
        await pilot.pause()
        assert "there" in shown(made)
        await pilot.click("TopBar", offset=(13, 0))
        await pilot.pause()
        assert "here" in shown(made)

    drive(made := app(), act)


@pytest.mark.lifecycle
def test_an_error_of_ours_ends_the_screen_and_lets_go_of_everything(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    done = []

    class Faulty(_Here):
        def on_mount(self) -> None:
            raise RuntimeError("ours")

    async def closed() -> None:
        done.append("closed")

    async def failing() -> None:
        done.append("failing")
        raise OSError("and this one")

    made = make(ScreenEntry("here", "f2", "traffic", Faulty))
    made.closers.push_async_callback(closed)
    made.closers.push_async_callback(failing)
    with pytest.raises(OSError, match="and this one"):
        asyncio.run(made.run_async(headless=True))
    assert done == ["failing", "closed"]
    assert "ours" in capsys.readouterr().err
    monkeypatch.setattr(made, "run", lambda: None)  # it has just been run
    with pytest.raises(SystemExit, match="1"):
        made.run_until_closed()


def test_a_screen_that_was_left_takes_the_theme_that_is_chosen_elsewhere() -> None:
    async def act(pilot: Pilot[None]) -> None:
        before = made.screen.styles.background
        await pilot.press("f3")
        made.theme = "light"
        await pilot.press("f2")
        assert isinstance(made.screen, _Here)
        assert made.screen.styles.background not in (before, None)
        assert made.screen.query_one(TopBar).styles.background.brightness > 0.5

    drive(made := app(), act)


@pytest.mark.lifecycle
def test_nothing_is_left_of_it_when_it_has_ended() -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("f3")
        assert gc.get_freeze_count()

    thresholds = gc.get_threshold()
    made = app()
    left = weakref.ref(made)
    drive(made, act)
    del made
    assert gc.get_threshold() == thresholds
    gc.collect()
    assert left() is None


def test_help_tells_every_key_of_the_screen() -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("f1")
        await pilot.pause()
        assert isinstance(made.screen, HelpScreen)
        text = shown(made)
        for word in ("Help: Traffic", "Quit", "Actions", "Next theme", "Screen: Keys"):
            assert word in text
        await pilot.press("escape")
        assert isinstance(made.screen, _Here)

    drive(made := app(), act, (100, 40))


def test_commands_are_found_by_a_part_of_their_name_and_done() -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("ctrl+p")
        await pilot.press(*"blind")
        await until(pilot, lambda: "Theme: colour-blind-safe" in shown(made))
        await pilot.press("enter")
        await until(pilot, lambda: made.theme == "safe")

    drive(made := app(), act, (100, 40))


def test_the_footer_shows_what_there_is_room_for_and_always_help() -> None:
    async def act(pilot: Pilot[None]) -> None:
        assert "Help" in shown(made).splitlines()[-1]
        assert "F1 Help  ^p Actions" in shown(made).splitlines()[-1]
        await pilot.click("KeyBar", offset=(shown(made).splitlines()[-1].index("Help"), 0))
        await until(pilot, lambda: isinstance(made.screen, HelpScreen))

    drive(made := app(), act, (40, 16))


def test_ctrl_c_tells_how_to_end() -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("ctrl+c")
        (note,) = made._notifications
        assert note.message == "Ctrl-Q quits"

    spots = (ScreenEntry("there", "f3", "shell.keys", _There),)
    drive(made := make(*spots), act)


def test_japanese_labels() -> None:
    async def act(pilot: Pilot[None]) -> None:
        assert "ヘルプ" in shown(made)
        assert {command.name for command in all_commands(made.screen, made)} >= {"終了", "テーマ: ダーク"}

    drive(made := app(language=Language.JAPANESE), act)


def test_the_theme_is_remembered(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("ctrl+t")

    drive(app(tmp_path / "screen.yaml"), act)
    assert read_settings(tmp_path / "screen.yaml")[0].theme == "light"
    again = app(tmp_path / "screen.yaml")
    assert again.theme == "light"


def test_broken_settings_are_told_and_not_fatal(tmp_path: Path) -> None:
    path = tmp_path / "screen.yaml"
    path.write_text("theme: [/red]\nhosts: 3")

    async def act(pilot: Pilot[None]) -> None:
        (note,) = made._notifications
        assert "Cannot read" in note.message

    drive(made := app(path), act)
    assert made.theme == "dark"


def test_settings_that_cannot_be_written_are_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")

    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("ctrl+t")
        assert any("Cannot write" in note.message for note in made._notifications)

    drive(made := app(tmp_path / "file" / "screen.yaml"), act)


@pytest.mark.lifecycle
def test_what_is_to_be_let_go_of_is_before_the_end_the_last_first() -> None:
    done = []

    async def act(pilot: Pilot[None]) -> None:
        for name in "ab":

            async def close(name: str = name) -> None:
                done.append(name)

            made.closers.push_async_callback(close)
        await pilot.press("ctrl+q")
        await pilot.press("ctrl+q")

    drive(made := app(), act)
    assert done == ["b", "a"]


@pytest.mark.lifecycle
def test_what_does_not_let_go_does_not_keep_the_screen_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.tui.app.CLOSE_TIMEOUT", 0.05)

    async def act(pilot: Pilot[None]) -> None:
        async def hang() -> None:
            await asyncio.Event().wait()

        made.closers.push_async_callback(hang)
        await pilot.press("ctrl+q")

    drive(made := app(), act)


@pytest.mark.lifecycle
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has neither")
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM])
def test_signals_close_in_order(tmp_path: Path, number: signal.Signals) -> None:
    master, slave = pty.openpty()
    argv = [sys.executable, "-m", "bcapscope", "tui", str(CAPTURES / "retry-story.pcapng")]
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    process = subprocess.Popen(
        argv, stdin=slave, stdout=slave, stderr=slave, env=environment, start_new_session=True
    )
    os.close(slave)
    drawn = b""
    end = time.monotonic() + 30
    while b"slvMove" not in drawn and time.monotonic() < end:
        drawn += _read(master)
    assert b"slvMove" in drawn
    process.send_signal(number)
    while process.poll() is None and time.monotonic() < end:
        drawn += _read(master)
    os.close(master)
    assert process.wait(10) == 0
    assert b"Traceback" not in drawn
    assert list((tmp_path / "bcapscope").glob("traffic-*")) == []


def _read(master: int) -> bytes:
    if not select.select([master], [], [], 0.1)[0]:
        return b""
    try:
        return os.read(master, 65536)
    except OSError:
        return b""
