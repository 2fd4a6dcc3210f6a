"""The Tester's screen: what the pages of b-CAP Tester do not have, and peers that are hostile or gone."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import numpy as np
from textual.events import Paste
from textual.pilot import Pilot
from textual.widgets import Button, Input, Select

from bcapscope.live.controller.error_recovery import RecoveryStep
from bcapscope.live.controller.history_record import RecordOutcome
from bcapscope.player.player_messages import PlayOutcome
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.tui.controller_access.builtin_simulator import START_JOINTS
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.tester.call_lists import HistoryLines, WatchList
from bcapscope.tui.tester.connection_panel import ConnectionPanel
from bcapscope.tui.tester.dialogs import ArmDialog
from bcapscope.tui.tester.form_tabs import TABS, FormTabs
from bcapscope.tui.tester.form_widgets import ChoiceRow
from tests.client.peer import Answer, Peer
from tests.client.server import udp_server
from tests.tui.marks import strip_styles
from tests.tui.pilot import drive, until
from tests.tui.tester import (
    COMMAND,
    RESULT,
    answered,
    connected,
    errors_read,
    execute,
    executed,
    finish,
    focus,
    go,
    make_tester,
    result,
    screen,
    sight,
    watched,
    write,
)

HOSTILE = "[/foo]\x1b[31m\u202e\ud800[red]" + "A" * 10_000
LONG_LIMIT = 110.0
"""Seconds for a test in which a player is started and plays."""

ANSWERS: dict[str, Answer | None] = {
    "Variable_GetValue": (0, [Variant(VT.BSTR, HOSTILE)]),
    "Robot_Execute": (0, [Variant(VT.BSTR, HOSTILE)]),
}


def test_hostile_strings_are_shown_and_never_interpreted(tmp_path: Path) -> None:
    with udp_server(lambda peer: peer.answers.update(ANSWERS)) as server:

        async def act(pilot: Pilot[None]) -> None:
            here = await connected(pilot)
            assert not here.session.status.identity.is_simulator
            await execute(pilot, "slvGetMode")
            text = await answered(pilot, RESULT, "[/foo]\\x1b[31m\\u202e\\ud800[red]AAA")
            assert len(text) < 5000
            for name in ("received", "history"):
                here.query_one("#view", ChoiceRow).chosen = name
                await pilot.pause()
                assert "[/foo]" in sight(pilot)
                assert "\x1b" not in sight(pilot)
            await focus(pilot, COMMAND)
            here.query_one(COMMAND, Input).value = "a\ud800"
            await pilot.press("home", "shift+end", "ctrl+c")
            assert pilot.app.clipboard == "a\\ud800"
            await execute(pilot, "[/foo]\\x")
            await until(pilot, lambda: isinstance(pilot.app.screen, ArmDialog))
            assert "[/foo]" in sight(pilot)  # the type of the robot
            await pilot.press("escape")
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", server.port), act, (120, 40))


def test_nothing_that_moves_goes_out_before_one_has_armed(tmp_path: Path) -> None:
    with udp_server() as server:

        def moves() -> int:
            calls = [call for peer in server.peers.values() for call in peer.executed]
            return sum(call[0] == "Robot_Execute" and call[2] == "slvMove" for call in calls)

        async def act(pilot: Pilot[None]) -> None:
            here = await connected(pilot)
            assert "SAFE" in sight(pilot)
            await execute(pilot, "slvMove", "1,2,3,4,5,6")
            await until(pilot, lambda: isinstance(pilot.app.screen, ArmDialog))
            assert "Do not arm" in sight(pilot)
            await pilot.press("enter")
            await answered(pilot, RESULT, "Not sent")
            assert moves() == 0
            await pilot.press("enter")
            await until(pilot, lambda: isinstance(pilot.app.screen, ArmDialog))
            await pilot.press("tab", "enter")
            await answered(pilot, RESULT, "1.00000, 2.00000")
            assert moves() == 1
            assert "ARMED 2:5" in sight(pilot)
            await pilot.press("f8")
            assert not here.session.arming.is_armed(here.session.now())
            here.query_one(FormTabs).show_tab(
                "task"
            )  # what is out of sight gets no keys when it is connected
            await pilot.press("f5")
            await until(pilot, lambda: not here.session.status.is_connected)
            await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
            await pilot.press("f5")
            await until(pilot, lambda: here.query_one("#task").has_focus_within)
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", server.port), act)


def test_a_call_that_is_not_answered_can_be_given_up(tmp_path: Path) -> None:
    with udp_server(lambda peer: peer.answers.update({"Robot_Execute": None})) as server:

        async def act(pilot: Pilot[None]) -> None:
            await connected(pilot)
            await execute(pilot, "slvGetMode")
            await answered(pilot, RESULT, "waiting")
            await pilot.press("escape")
            await answered(pilot, RESULT, "cancelled")
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", server.port), act)


def test_who_has_gone_elsewhere_while_it_was_connecting_is_left_there(tmp_path: Path) -> None:
    goes_on = threading.Event()

    def hold(peer: Peer) -> None:
        goes_on.wait(LONG_LIMIT)

    with udp_server(hold) as server:

        async def act(pilot: Pilot[None]) -> None:
            here = screen(pilot)
            here.query_one("#option", Input).value = "Timeout=60000"
            await pilot.press("f5")
            await until(pilot, lambda: server.peers)
            await focus(pilot, "#view")
            goes_on.set()
            workers = pilot.app.workers
            await workers.wait_for_complete([each for each in workers if each.group == "connect"])
            await pilot.pause()
            assert here.session.status.robot is not None
            assert here.focused is here.query_one("#view")
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", server.port), act)


def test_nobody_there_and_wrong_fields_are_told(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        panel = here.query_one(ConnectionPanel)
        here.query_one("#option", Input).value = "Timeout=abc"
        assert isinstance(panel.wanted_connection(), str)
        assert "F5 Connect" in sight(pilot)
        await until(pilot, lambda: "expected a whole number from 1 to 600000" in sight(pilot))
        here.query_one("#option", Input).value = "Timeout=50,Retry=1"
        here.query_one("#host", Input).value = "127.0.0.1:9"  # goes before what stands in the port's field
        here.query_one("#port", Input).value = "10"
        await pilot.press("f5")
        await until(pilot, lambda: "no reply to 2 attempts" in sight(pilot))
        assert "✗ service" in sight(pilot)
        await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
        assert here.query_one("#port", Input).value == "9"
        await finish(pilot)

    drive(make_tester(tmp_path, "127.0.0.1", 9), act)


def test_history_again_edit_copy_save_and_filter(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = await connected(pilot)
        await execute(pilot, "slvGetMode")
        await answered(pilot, RESULT, "0")
        here.query_one("#view", ChoiceRow).chosen = "history"
        lines = here.query_one(HistoryLines)
        lines.focus()
        count = lines.count
        await pilot.press("r")
        await until(pilot, lambda: lines.count == count + 1)
        assert lines.current_item is not None
        assert lines.current_item.outcome is RecordOutcome.ANSWERED
        for key, text in (("x", "01 "), ("p", "from bcapscope.client"), ("c", "bcapscope call 127.0.0.1")):
            await pilot.press(key)
            assert pilot.app.clipboard.startswith(text)
        await pilot.press("s")
        await pilot.press(*"my-mode", "enter")
        await until(pilot, lambda: list((tmp_path / "requests").glob("*my-mode.yaml")))
        here.query_one("#history-filter", Input).value = "hresult != S_OK"
        await until(pilot, lambda: lines.count == 0)
        here.query_one("#history-filter", Input).value = "hresult !="
        await until(pilot, lambda: here.query_one("#history-filter").has_class("-invalid"))
        here.query_one("#history-filter", Input).value = "slvgetmode"
        await until(pilot, lambda: lines.count == 2)
        lines.focus()
        await pilot.press("e")
        await until(pilot, lambda: here.query("#function #field0"))
        assert "slvGetMode" in [each.value for each in here.query("#function .value").results(Input)]
        assert "64 Robot_Execute ▾" in sight(pilot)
        await finish(pilot)

    drive(make_tester(tmp_path), act)


def test_variables_are_read_written_and_watched(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = await connected(pilot)
        await until(pilot, lambda: "F5 Disconnect" in sight(pilot))
        here.query_one("#tabs", ChoiceRow).chosen = "variable"
        await focus(pilot, "#variable .name")
        await write(pilot, "I5")
        await pilot.press("enter")
        await until(pilot, lambda: here.session.status.open_objects[-1].label == "I5")
        await go(pilot, "#variable .value")
        await write(pilot, "x")
        await until(pilot, lambda: "expected: a whole number" in result(pilot, "#variable ResultView"))
        await write(pilot, "42")
        await pilot.press("enter")
        await answered(pilot, "#variable ResultView", "(EMPTY)")
        await pilot.press("tab", "enter")
        await answered(pilot, "#variable ResultView", "42")
        lines = here.query_one(HistoryLines)
        put, got = (strip_styles(lines.line(lines.count - back)) for back in (2, 1))
        assert "Variable_PutValue I5(42) S_OK" in put
        assert "Variable_GetValue I5 S_OK" in got
        await pilot.press("tab", "tab", "enter")
        watch = here.query_one(WatchList)
        await until(pilot, lambda: watch.count == 2 and "  42  " in strip_styles(watch.line(1)))
        watch.focus()
        await pilot.press("end", "delete")
        await until(pilot, lambda: watch.count == 0)
        await finish(pilot)

    drive(make_tester(tmp_path), act)


def test_raw_bytes_are_explained_and_sent(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = await connected(pilot)
        here.query_one("#tabs", ChoiceRow).chosen = "raw"
        await focus(pilot, "#raw .value")
        field = here.query_one("#raw .value", Input)
        field.value = "01 1"
        await answered(pilot, "#raw ResultView", "Type pairs of hex")
        field.value = ""
        field.post_message(Paste("01 00 00 00 00 34 12 00\n00 13 00 00 00 00 00 04\n"))
        await answered(pilot, "#raw ResultView", "Controller_GetAttribute, serial 4660")
        await pilot.press("enter")
        await answered(pilot, "#raw ResultView", "E_")
        await until(pilot, lambda: "34 12" in sight(pilot))
        await finish(pilot)

    drive(make_tester(tmp_path), act)


def test_the_way_out_of_an_error(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = await connected(pilot)
        assert "needs RobSlave for this" in await executed(pilot, "slvChangeMode", "2")
        await pilot.press("ctrl+b")
        assert (await executed(pilot, "slvChangeMode", "2")).startswith("(EMPTY)")
        await executed(pilot, "slvMove", "12.42, 60.36, 17.63, 35.81, 20.43, 23.95")
        for _ in range(2):  # the error is the answer to the next set point
            await executed(pilot, "slvMove", "90, 60.36, 17.63, 35.81, 20.43, 23.95")
        await until(pilot, lambda: here.session.status.slave_mode == 0)
        await pilot.press("f7")
        await errors_read(pilot)
        for step in list(RecoveryStep)[1:]:
            button = pilot.app.screen.query_one(f"#do-{step}")
            await until(pilot, lambda button=button: pilot.app.focused is button)  # type: ignore[misc]  # bound now
            await pilot.press("enter")
        await until(pilot, lambda: here.session.status.slave_mode == 2)
        await pilot.press("escape", "f12")
        await finish(pilot)

    drive(make_tester(tmp_path), act, (100, 40), LONG_LIMIT)


def trajectory(folder: Path) -> Path:
    """Write a small swing of J6 that begins and ends where the simulator stands."""
    path = folder / "swing.csv"
    points = np.tile(np.array(START_JOINTS[:6]), (120, 1))
    points[:, 5] += 1.0 - np.cos(np.linspace(0, 2 * np.pi, 120))
    rows = "\n".join(",".join(f"{value:.6f}" for value in row) for row in points)
    path.write_text(f"J1,J2,J3,J4,J5,J6\n{rows}\n")
    return path


def test_slave_mode_with_a_log_file_and_start(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        tester = await connected(pilot)
        await executed(pilot, "TakeArm", "0, 0")
        assert tester.session.status.holds_arm  # which the player needs
        await pilot.press("f9")
        await until(pilot, lambda: isinstance(pilot.app.screen, SlaveScreen))
        here = pilot.app.screen
        assert isinstance(here, SlaveScreen)
        here.query_one("#mode", Select).value = "async"
        await write(pilot, str(trajectory(tmp_path)))
        await until(pilot, lambda: not here.query_one("#start", Button).disabled)
        assert "fit to play: 120 set points" in sight(pilot)
        await pilot.press("f9")
        await until(pilot, lambda: here.playback is not None and here.playback.progress is not None)
        assert (await watched(pilot, here)).outcome is PlayOutcome.DONE
        await until(pilot, lambda: "played to the end" in sight(pilot))
        assert "commanded" in sight(pilot)
        assert list((tmp_path / "log").glob("slave-*.pcapng"))
        await pilot.press("escape")
        await finish(pilot)

    drive(make_tester(tmp_path), act, (120, 40), LONG_LIMIT)


def test_slave_mode_is_halted_and_the_screen_closed_in_order(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await connected(pilot)
        await pilot.press("f9")
        await until(pilot, lambda: isinstance(pilot.app.screen, SlaveScreen))
        here = pilot.app.screen
        assert isinstance(here, SlaveScreen)
        here.query_one("#mode", Select).value = "async"
        here.query_one("#rounds", Input).value = "0"
        await write(pilot, str(trajectory(tmp_path)))
        await until(pilot, lambda: not here.query_one("#start", Button).disabled)
        await pilot.press("f9")
        await until(pilot, lambda: here.playback is not None and here.playback.samples)
        await pilot.press("f12")
        await until(
            pilot, lambda: here.playback is not None and (here.playback.ended or here.playback.question)
        )
        await asyncio.sleep(0)
        await finish(pilot)

    drive(make_tester(tmp_path), act, limit=LONG_LIMIT)


def test_japanese(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await connected(pilot)
        text = sight(pilot)
        assert "接続" in text
        assert "シミュレータ" in text
        assert "スレーブモードでないときの slvMove" in await executed(pilot, "slvMove", "1,2,3,4,5,6")
        await execute(pilot, "slvChangeMode", "two")
        assert "整数 -32768 から" in await answered(pilot, RESULT, "'two' は VT_I2 ではありません")
        await finish(pilot)

    drive(make_tester(tmp_path, japanese=True), act)


def test_all_digits_by_one_key(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await connected(pilot)
        assert "12.42261, 60.36072" in await executed(pilot, "CurJnt")
        await pilot.press("f10")
        assert "12.422607, 60.360718" in result(pilot, RESULT)
        await pilot.press("f10")
        assert "12.42261, 60.36072" in result(pilot, RESULT)
        await finish(pilot)

    drive(make_tester(tmp_path), act)


def test_tabs_and_views_are_a_key_or_a_command_away(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        for tab in (*TABS[1:], TABS[0]):
            await pilot.press("ctrl+n")
            await until(pilot, lambda tab=tab: here.query_one(f"#{tab}").has_focus_within)  # type: ignore[misc]  # bound now
        await pilot.press("ctrl+p", *"view: hist")
        await until(pilot, lambda: "View: History" in sight(pilot))
        await pilot.press("enter")
        await until(pilot, lambda: here.query_one("#history").has_focus_within)
        await pilot.press("ctrl+y")
        await until(pilot, lambda: here.query_one("#watch").has_focus)
        await finish(pilot)

    drive(make_tester(tmp_path, "127.0.0.1", 9), act)


def test_a_name_that_was_begun_is_completed_first_and_its_parameter_asked_for(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("enter")  # the simulator may not have started yet
        await until(pilot, lambda: pilot.app.focused is screen(pilot).query_one(COMMAND))
        value = screen(pilot).query_one("#execute TypedValue .value", Input)
        await execute(pilot, "slvgetm")
        assert screen(pilot).query_one(COMMAND, Input).value == "slvGetMode"
        assert result(pilot, RESULT).startswith("returns the slave mode")
        await pilot.press("enter")
        await answered(pilot, RESULT, "0")
        await execute(pilot, "slvMove")
        await until(pilot, lambda: pilot.app.focused is value)
        await pilot.press("1", "enter")
        await answered(pilot, RESULT, "0x83500121")
        for command, parameter in (("slvGetMode", ""), ("slvMove", "1")):  # what it was sent with comes back
            await focus(pilot, COMMAND)
            await write(pilot, command)
            await until(pilot, lambda parameter=parameter: value.value == parameter)  # type: ignore[misc]
        await finish(pilot)

    drive(make_tester(tmp_path), act)


def test_a_wrong_filter_says_why(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        here.query_one("#view", ChoiceRow).chosen = "history"
        await focus(pilot, "#history-filter")
        await pilot.press(*"hresult !=")
        await until(pilot, lambda: "^" in sight(pilot))
        assert here.query_one("#history-filter").has_class("-invalid")
        await finish(pilot)

    drive(make_tester(tmp_path, "127.0.0.1", 9), act)


def test_limits_that_the_user_knows_are_kept(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("f9")
        await until(pilot, lambda: isinstance(pilot.app.screen, SlaveScreen))
        here = pilot.app.screen
        start = here.query_one("#start", Button)
        await pilot.press("f9")
        assert "cannot start yet" in sight(pilot)
        here.query_one("#file", Input).value = str(trajectory(tmp_path))
        await until(pilot, lambda: not start.disabled)
        assert "limits of an unknown arm" in sight(pilot)
        here.query_one("#limits", Input).value = "J6=20..25 J6.speed"
        await until(pilot, lambda: "'J6.speed' is not a limit" in sight(pilot))
        here.query_one("#limits", Input).value = "J6=20..25"
        await until(pilot, lambda: "its limits are 20 and 25" in sight(pilot))
        assert start.disabled
        here.query_one("#limits", Input).value = "J6=20..30, J6.speed=300"
        await until(pilot, lambda: not start.disabled)
        here.query_one("#rounds", Input).value = "1.5"
        await until(pilot, lambda: "rounds and no. are whole" in sight(pilot))
        await pilot.press("escape")
        await finish(pilot)

    drive(make_tester(tmp_path, "127.0.0.1", 9), act, (120, 40))
