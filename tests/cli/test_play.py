"""``bcapscope play`` as a user runs it: over TCP, since that forgives a simulator on a busy machine."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from bcapscope.cli.play import PlayOutput, PlayRunner
from bcapscope.messages import ENGLISH_WORDS
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.color_palette import PLAIN
from tests.cli.run import CAPTURES, Ran, run_here
from tests.cli.test_sim import simulator
from tests.client.peer import Peer
from tests.client.server import udp_server
from tests.player.simulated import wave

SWING = CAPTURES / "swing-joints.csv"
POSITIONS = CAPTURES / "half-circle-positions.csv"
PATIENCE = 30.0


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with simulator("-q") as (_, port):
        yield port


@pytest.fixture
def gentle(tmp_path: Path) -> Path:
    """Write a way so slow that a set point more or less is no excess."""
    rows = [",".join(map(str, point)) for point in wave(150, 0.1)]
    path = tmp_path / "gentle.csv"
    path.write_text("\n".join(["J1_deg,J2_deg,J3_deg,J4_deg,J5_deg,J6_deg", *rows, ""]))
    return path


def play(port: int, file: Path, *words: str | Path) -> Ran:
    """Run it without a terminal."""
    return run_here("play", file, "127.0.0.1", "-p", str(port), "--tcp", *words)


def test_it_plays_and_records(port: int, gentle: Path, tmp_path: Path) -> None:
    record, log = tmp_path / "all.pcapng", tmp_path / "log.csv"
    words = (
        "--mode",
        "0x102",
        "--speed",
        "0.9",
        "--move-to-start",
        "--record",
        record,
        "--log",
        log,
        "--json",
    )
    ran = play(port, gentle, *words)
    assert ran.code == 0, ran.err + ran.out
    before, after = map(json.loads, ran.lines)
    assert [column["title"] for column in before["columns"]] == [f"J{axis}_deg" for axis in range(1, 7)]
    assert (after["outcome"], after["left_in_order"]) == ("done", True)
    assert set(after["lateness_ms"]) == {"p50", "p99", "p999", "most"}
    assert "bcapscope's simulator, no robot moves, RC8" in ran.err
    calls = run_here("calls", record, "--json", "--port", str(port), "-f", 'command == "slvMove"')
    outcomes = Counter(json.loads(line)["outcome"] for line in calls.lines)
    assert outcomes.total() > 150
    assert outcomes["answered"]  # the simulator of a busy machine may owe some
    assert log.read_text(encoding="utf-8").startswith("[J1 - 指令値],")


def test_a_dry_run_moves_nothing(port: int) -> None:
    ran = play(port, POSITIONS, "--dry-run", "--json")
    assert ran.code == 0, ran.err
    (found,) = map(json.loads, ran.lines)
    assert (found["type"], found["fit"], found["needs_move"]) == ("P", True, True)
    assert "slave mode 0x201" in ran.err


def test_what_is_not_fit_is_not_played() -> None:
    ran = play(1, SWING, "--loop", "2", "--index", "1", "--speed", "9", "--limit", "J6=0..10")
    assert ran.code == 11
    assert "J6" in ran.out
    assert "not fit to play" in ran.out


def test_limits_of_the_simulated_arm_hold_for_it(port: int, tmp_path: Path) -> None:
    file = tmp_path / "fast.csv"
    file.write_text("".join(f"{number % 2 * 5},0,90,0,90,0\n" for number in range(20)))
    ran = play(port, file)
    assert ran.code == 11, ran.out + ran.err
    assert "limits of the simulated arm" in ran.out
    assert "Robot" not in ran.err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--mode", "0x999"), "is not a slave mode. Give sync, async, or a number"),
        (("--limit", "J1=fast"), "is not a range"),
    ],
)
def test_a_command_line_without_sense(words: tuple[str, ...], reason: str) -> None:
    ran = play(1, SWING, *words)
    assert (ran.code, ran.out) == (2, "")
    assert reason in ran.err


def test_a_file_that_holds_no_trajectory() -> None:
    ran = play(1, CAPTURES / "README.md")
    assert (ran.code, ran.out) == (4, "")
    assert ran.err.count("\n") == 1


def test_nobody_there(tmp_path: Path) -> None:
    ran = play(1, SWING)
    assert ran.code == 9
    assert "given up: no answer: 127.0.0.1:1 over TCP: connection refused" in ran.out


def test_files_are_not_written_over(tmp_path: Path) -> None:
    taken = tmp_path / "a.pcapng"
    taken.write_bytes(b"mine")
    ran = play(1, SWING, "--record", taken)
    assert (ran.code, ran.out) == (6, "")
    assert taken.read_bytes() == b"mine"


def stand_at_home(peer: Peer) -> None:
    """Tell a pose, whatever variable is asked for; so it is no simulator, and its motor is on."""
    peer.answers["Variable_GetValue"] = 0, [Variant.array(VT.R8, (0.0, 0.0, 90.0, 0.0, 90.0, 0.0))]


def test_whoever_is_no_simulator_needs_arming() -> None:
    with udp_server(stand_at_home) as server:
        ran = run_here("play", SWING, "127.0.0.1", "-p", str(server.port))
        (peer,) = server.peers.values()
    assert ran.code == 10, ran.out + ran.err
    assert "A robot will move: " in ran.err
    assert "not played: this is not the simulator, and you did not confirm that a robot may move" in ran.out
    assert "Robot_Execute" not in peer.functions
    assert peer.functions[-1] == "Service_Stop"


def _own_terminal() -> None:
    """Make standard input the terminal that a new session belongs to, as a login does."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Terminal:
    """A terminal that a program is run in."""

    def __init__(self, *words: str) -> None:
        self._ours, theirs = pty.openpty()
        argv = [sys.executable, "-m", "bcapscope", *words]
        self.process = subprocess.Popen(
            argv,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            preexec_fn=_own_terminal,  # noqa: PLW1509 - no other thread is running here
        )
        os.close(theirs)
        self.shown = ""

    def until(self, text: str) -> None:
        """Read until some text has come."""
        give_up = time.monotonic() + PATIENCE
        while text not in self.shown:
            assert time.monotonic() < give_up, self.shown[-2000:]
            if select.select((self._ours,), (), (), 1.0)[0]:
                self.shown += os.read(self._ours, 4096).decode(errors="replace")

    def press(self, keys: str) -> None:
        """Type something."""
        os.write(self._ours, keys.encode())

    def close(self) -> int:
        """Wait for the end and return the exit code."""
        give_up = time.monotonic() + PATIENCE
        while self.process.poll() is None:  # read on, or it would wait for us
            assert time.monotonic() < give_up
            if select.select((self._ours,), (), (), 0.1)[0]:
                with suppress(OSError):  # its end of the terminal is closed
                    os.read(self._ours, 4096)
        code = self.process.wait()
        os.close(self._ours)
        return code


def test_questions_and_keys_on_a_terminal(port: int, gentle: Path) -> None:
    away = ("Robot_Execute TakeArm", "Robot_Execute Motor i4[]:1,0", 'Robot_Move 1 "@E J(5,0,90,0,90,0)"')
    calls = [word for call in away for word in ("--exec", call)]
    moved = run_here("call", "127.0.0.1", "-p", str(port), *calls)
    assert moved.code == 0, moved.out + moved.err
    words = ("play", str(gentle), "127.0.0.1", "-p", str(port), "--tcp", "--mode", "async", "--loop", "0")
    terminal = Terminal(*words)
    terminal.until("Answer (no, yes) [no]: ")
    terminal.press("yes\n")
    terminal.until("playing 1")
    terminal.press("\x1b[A")
    terminal.press("s")
    terminal.until("stopped on the way, at rest")
    assert terminal.close() == 0


@pytest.mark.lifecycle
@pytest.mark.parametrize("keys", ["\x03", "\x1a"])
def test_ctrl_c_and_ctrl_z_bring_the_robot_to_rest(port: int, gentle: Path, keys: str) -> None:
    words = ("play", str(gentle), "127.0.0.1", "-p", str(port), "--tcp", "--mode", "async", "--loop", "500")
    terminal = Terminal(*words, "--move-to-start")
    terminal.until("playing 1")
    terminal.press(keys)
    terminal.until("stopped on the way, at rest: stop was requested")
    assert terminal.close() == 130


@pytest.mark.parametrize(
    ("typed", "code"), [("127.0.0.1\n", 0), ("yes\n", 10), ("\x03", 130), ("\x03\x03\n", 130)]
)
def test_the_host_is_typed_to_let_a_robot_move(tmp_path: Path, typed: str, code: int) -> None:
    file = tmp_path / "still.csv"
    file.write_text("0,0,90,0,90,0\n" * 10)
    with udp_server(stand_at_home) as server:
        terminal = Terminal("play", str(file), "127.0.0.1", "-p", str(server.port), "--mode", "async")
        terminal.until("Type 127.0.0.1 to confirm that this robot may move: ")
        terminal.press(f"{typed}\n")
        if code != 130:  # a second Ctrl-C may end the command before it prints why
            terminal.until("not played" if code else "played to the end")
        assert terminal.close() == code
        (peer,) = server.peers.values()
    moved = [call for call in peer.executed if "slvMove" in call]
    assert len(moved) == (14 if code == 0 else 0)
    assert peer.functions[-1] == "Service_Stop"


def test_a_second_ctrl_c_halts_even_while_the_first_one_waits_for_the_player() -> None:
    orders: list[str] = []
    nothing: Any = None
    runner = PlayRunner(nothing, nothing, nothing)

    class Hanging:
        """A player that reads no orders, so that `stop` waits and the next signal interrupts it."""

        def stop(self) -> None:
            orders.append("stop")
            if len(orders) < 3:
                runner._on_signal(signal.SIGINT, None)

        def halt(self) -> None:
            orders.append("halt")

    player: Any = Hanging()
    runner._player = player
    runner._on_signal(signal.SIGINT, None)
    assert orders == ["stop", "halt"]


def test_nothing_more_is_printed_once_the_terminal_is_closed(capsys: pytest.CaptureFixture[str]) -> None:
    output = PlayOutput(False, PLAIN, 80, ENGLISH_WORDS)

    def lines() -> Iterator[str]:
        yield "before"
        output.close()
        yield "after"

    output._print_data(lines())
    assert capsys.readouterr().out == "before\n"
