"""The Tester when its controller, or its terminal, goes away: real processes, killed in the middle."""

from __future__ import annotations

import asyncio
import fcntl
import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Button, Checkbox, Input, Select

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.client.session import command_of
from bcapscope.live.child_process import ChildProcess
from bcapscope.live.controller.halt_connection import HaltState
from bcapscope.player.player_messages import PlayOutcome, SlaveModePacing
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.traffic.observation import Direction
from bcapscope.tui.controller_access.builtin_simulator import (
    START_JOINTS,
    BuiltInSimulator,
    run_builtin_simulator,
)
from bcapscope.tui.screens import tester_screen
from bcapscope.tui.screens.slave_screen import SlaveScreen
from bcapscope.tui.screens.tester_screen import TesterScreen as Window
from bcapscope.tui.tester.connection_panel import ConnectionPanel
from bcapscope.tui.tester.packet_pane import PacketPane
from tests.client.server import udp_server
from tests.tui.pilot import drive, until
from tests.tui.tester import (
    answered,
    connected,
    executed,
    finish,
    focus,
    make_tester,
    ready,
    result,
    screen,
    sight,
    write,
)

pty = pytest.importorskip("pty", reason="there are no pseudo-terminals here")

LIMIT = 90.0
"""Seconds for a test in which a player is started, or a time-out waited for."""

LONG = 5000
"""Set points that last longer than the test."""

MOVED = "#move ResultView"
FAR = "@E J(-90,0,90,0,0,0)"


async def join(pilot: Pilot[None], port: int, *, tcp: bool = False, option: str = "") -> Window:
    """Connect to a simulator."""
    here = screen(pilot)
    here.query_one("#port", Input).value = str(port)
    here.query_one("#udp", Checkbox).value = not tcp
    here.query_one("#option", Input).value = option
    await pilot.press("f5")
    await ready(pilot)
    return here


async def begin_to_move(pilot: Pilot[None]) -> None:
    """Begin a motion whose call is answered when it has ended, in several seconds."""
    here = screen(pilot)
    await executed(pilot, "ExtSpeed", "1")
    await focus(pilot, "#robot-choice")
    await pilot.press("right")
    here.query_one("#move #field1 .value", Input).value = FAR
    await focus(pilot, "#move #field1 .value")
    await pilot.press("enter")
    await answered(pilot, MOVED, "waiting")


@pytest.mark.parametrize(
    ("tcp", "reason"),
    [(False, "no reply to 5 attempts"), (True, "closed the connection")],
    ids=["udp", "tcp"],
)
def test_killed_in_the_middle_of_a_call(tmp_path: Path, tcp: bool, reason: str) -> None:
    async def act(pilot: Pilot[None]) -> None:
        with run_builtin_simulator("rc7") as simulator:
            here = await join(pilot, simulator.port, tcp=tcp)
            await begin_to_move(pilot)
            simulator.process.kill()
            await until(pilot, lambda: reason in result(pilot, MOVED))
            await until(pilot, lambda: here.halt_update.state in (HaltState.LOST, HaltState.CLOSED))
            assert here.session.status.is_connected is not tcp  # over UDP, it may come back
            assert reason in sight(pilot)
            if not tcp:
                here.query_one(PacketPane).show_view("history")
                await until(pilot, lambda: re.search(r"5 serial \d+, reserved \d+, sent at", sight(pilot)))
                await pilot.press("f5")
                await until(pilot, lambda: not here.session.status.is_connected)
            await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
            await pilot.press("f5")
            refused = "connection refused" if tcp else "no reply to 5 attempts"
            await until(pilot, lambda: refused in sight(pilot))
            await finish(pilot)

    drive(make_tester(tmp_path, "127.0.0.1", 9), act, (160, 48), LIMIT)


def test_gone_in_the_middle_of_a_connect_over_udp(tmp_path: Path) -> None:
    with udp_server(lambda peer: peer.answers.update({"Controller_Connect": None})) as server:

        async def act(pilot: Pilot[None]) -> None:
            here = screen(pilot)
            here.query_one("#option", Input).value = "Timeout=50,Retry=1"
            await pilot.press("f5")
            await until(pilot, lambda: "✗ controller" in sight(pilot))
            assert "● service" in sight(pilot)
            await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
            assert "no reply to 2 attempts" in sight(pilot)
            assert not here.session.status.is_connected
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", server.port), act)


@contextmanager
def hanging_up() -> Iterator[int]:
    """Answer no connection: hang up as soon as something comes."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            while True:
                try:
                    there, _ = listener.accept()
                except OSError:
                    return
                with there:
                    there.recv(1000)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_gone_in_the_middle_of_a_connect_over_tcp(tmp_path: Path) -> None:
    with hanging_up() as port:

        async def act(pilot: Pilot[None]) -> None:
            here = screen(pilot)
            here.query_one("#udp", Checkbox).value = False
            await pilot.press("f5")
            await until(pilot, lambda: "✗ service" in sight(pilot))
            assert "the other end closed the connection" in sight(pilot)
            await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", port), act)


def test_a_connect_is_given_up(tmp_path: Path) -> None:
    with udp_server(lambda peer: peer.answers.update({"Controller_Connect": None})) as server:

        async def act(pilot: Pilot[None]) -> None:
            here = screen(pilot)
            await pilot.press("f5")
            await until(pilot, lambda: "◌ controller" in sight(pilot))
            await pilot.press("escape")
            await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
            assert not here.session.status.is_connected
            await finish(pilot)

        drive(make_tester(tmp_path, "127.0.0.1", server.port), act)


def test_the_built_in_simulator_is_killed_and_started_anew(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = await connected(pilot)
        first = here.query_one("#port", Input).value
        assert here._simulator is not None
        here._simulator.process.kill()
        here._simulator.process.wait()
        await until(pilot, lambda: here.halt_update.state is HaltState.LOST)
        assert "HALT lost" in sight(pilot)
        await pilot.press("f5")
        await until(pilot, lambda: not here.session.status.is_connected)
        panel = here.query_one(ConnectionPanel)
        await until(pilot, lambda: not panel.query_one("#connect", Button).disabled)
        await pilot.press("f5")
        await until(pilot, lambda: here.session.status.robot is not None)
        assert here.query_one("#port", Input).value != first
        await finish(pilot)

    drive(make_tester(tmp_path), act, limit=LIMIT)


class HeldStart:
    """Starts built-in simulators, each as soon as `may_start` is set."""

    def __init__(self) -> None:
        self.may_start = threading.Event()
        self.begun = 0
        self.started: list[BuiltInSimulator] = []

    @contextmanager
    def run(self, profile: str) -> Iterator[BuiltInSimulator]:
        self.begun += 1
        assert self.may_start.wait(LIMIT)
        with run_builtin_simulator(profile) as simulator:
            self.started.append(simulator)
            yield simulator


def test_a_simulator_that_starts_while_the_screen_closes_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = HeldStart()
    monkeypatch.setattr(tester_screen, "run_builtin_simulator", start.run)
    app = make_tester(tmp_path)

    async def act(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: start.begun)
        closing = asyncio.ensure_future(app._run_closers())
        await until(pilot, lambda: not screen(pilot).session._thread.is_alive())
        start.may_start.set()
        await closing
        await until(pilot, lambda: start.started)
        assert start.started[0].process.poll() is not None

    drive(app, act, limit=LIMIT)


def test_cancelled_while_the_built_in_simulator_starts_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = HeldStart()
    start.may_start.set()
    monkeypatch.setattr(tester_screen, "run_builtin_simulator", start.run)

    async def act(pilot: Pilot[None]) -> None:
        here = await connected(pilot)
        start.started[0].process.kill()
        start.started[0].process.wait()
        await pilot.press("f5")
        await until(pilot, lambda: not here.session.status.is_connected)
        await until(pilot, lambda: not here.query_one("#connect", Button).disabled)
        start.may_start.clear()
        await pilot.press("f5")
        await until(pilot, lambda: start.begun == 2)
        await pilot.press("escape")
        start.may_start.set()
        await until(pilot, lambda: len(start.started) == 2)
        renewed = str(start.started[1].port)
        await until(pilot, lambda: here.query_one("#port", Input).value == renewed)
        assert not here.query_one("#connect", Button).disabled
        await pilot.press("f5")
        await until(pilot, lambda: here.session.status.robot is not None)
        await finish(pilot)

    drive(make_tester(tmp_path), act, limit=LIMIT)


@pytest.mark.parametrize("pacing", SlaveModePacing)
def test_killed_while_the_player_plays(tmp_path: Path, pacing: SlaveModePacing) -> None:
    async def act(pilot: Pilot[None]) -> None:
        with run_builtin_simulator("rc7") as simulator:
            await join(pilot, simulator.port)
            await pilot.press("f9")
            await until(pilot, lambda: isinstance(pilot.app.screen, SlaveScreen))
            here = pilot.app.screen
            assert isinstance(here, SlaveScreen)
            here.query_one("#mode", Select).value = pacing
            here.query_one("#rounds", Input).value = "0"
            await until(pilot, lambda: isinstance(pilot.app.focused, Input))
            await write(pilot, str(motionless_trajectory(tmp_path)))
            await until(pilot, lambda: not here.query_one("#start", Button).disabled)
            await pilot.press("f9")
            await until(pilot, lambda: here.playback is not None and here.playback.samples)
            simulator.process.kill()
            await until(pilot, lambda: here.playback is not None and here.playback.ended is not None)
            assert here.playback is not None
            assert here.playback.ended is not None
            assert here.playback.ended.outcome is PlayOutcome.UNANSWERED
            assert "given up: no answer" in sight(pilot)
            await until(pilot, lambda: not here.query_one("#start", Button).disabled)
            assert list(recorded(Path(here.playback.plan.record or "")))
            await pilot.press("escape")
            await until(pilot, lambda: pilot.app.screen is screen(pilot))
            await finish(pilot)

    drive(make_tester(tmp_path, "127.0.0.1", 9), act, (120, 40), LIMIT)


def motionless_trajectory(folder: Path) -> Path:
    """Write set points that hold the built-in simulator where it stands, but for a breath of J6."""
    path = folder / "standing.csv"
    axes = ",".join(f"{value:.6f}" for value in START_JOINTS[:5])
    rows = [f"{axes},{START_JOINTS[5] + 0.001 * (number % 2):.6f}" for number in range(100)]
    path.write_text("J1,J2,J3,J4,J5,J6\n" + "\n".join(rows) + "\n")
    return path


def recorded(path: Path) -> Iterator[tuple[str, str, object]]:
    """Yield what clients asked: port of the client, command or function, parameter of a command."""
    with open_capture(path) as capture:
        for seen in PacketDecoder().decode(capture):
            item = seen.item
            if isinstance(item, Frame) and seen.flow.direction is Direction.REQUEST:
                values = tuple(argument.variant for argument in item.arguments)
                command = command_of(item.code, values)
                client = str(seen.flow.conversation.client)
                yield client, command or function_name(item.code), values[2].value if command else None


@pytest.mark.lifecycle
@pytest.mark.parametrize("way", ["closed", "hung up"])
def test_the_terminal_is_closed_while_the_player_plays(tmp_path: Path, way: str) -> None:
    """The robot comes to rest, slave mode is left, everything is let go, and nothing is left running."""
    swing = tmp_path / "swing.csv"
    rows = "\n".join("0,0,90,0,90,0.001" if number % 2 else "0,0,90,0,90,0" for number in range(LONG))
    swing.write_text(f"J1,J2,J3,J4,J5,J6\n{rows}\n")
    (tmp_path / "bcapscope").mkdir()
    (tmp_path / "bcapscope" / "screen.yaml").write_text(f"trajectories:\n- {swing}\n")
    record = tmp_path / "seen.pcapng"
    simulator = ChildProcess("sim", "--port", "0", "--record", str(record), "--quiet")
    try:
        port = simulator.listen_addresses[0].rpartition(":")[2]
        with screen_on_a_terminal(tmp_path, "127.0.0.1", "-p", port) as (process, near):
            screen_output = ScreenOutput(near)
            screen_output.until(b"Enter or F5 connects")
            os.write(near, b"\r")
            screen_output.until(b"F12 HALT ")
            os.write(near, b"\x1b[20~")  # F9
            screen_output.until(b"fit to play")
            os.write(near, b"\x1b[20~")
            screen_output.until(b"commanded")
            if way == "closed":
                os.close(near)
            else:
                process.send_signal(signal.SIGHUP)
                screen_output.drain(process)
                os.close(near)
            assert process.wait(LIMIT) == 0
            assert b"Traceback" not in screen_output.seen
    finally:
        simulator.terminate()
    asked = list(recorded(record))
    clients = {client for client, name, _ in asked if name == "Service_Start"}
    assert len(clients) == 3  # the calls, HALT, the player
    for client in clients:
        assert [name for one, name, _ in asked if one == client][-1] == "Service_Stop"
    (player,) = {client for client, name, _ in asked if name == "slvmove"}
    played = [(name, value) for client, name, value in asked if client == player]
    assert played.index(("slvchangemode", 0)) > max(
        at for at, each in enumerate(played) if each[0] == "slvmove"
    )


@contextmanager
def screen_on_a_terminal(home: Path, *words: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Run the screen as the leader of a terminal; what it writes and keeps lies in `home`."""
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    argv = [sys.executable, "-m", "bcapscope", "tui", *words]
    lead = f"import os; os.login_tty({far}); os.execv({argv[0]!r}, {argv!r})"
    places = {f"XDG_{name}_HOME": str(home) for name in ("CACHE", "CONFIG", "DATA", "STATE")}
    environment = {**os.environ, "TERM": "xterm-256color", "LANG": "C.UTF-8", **places}
    process = subprocess.Popen(
        [sys.executable, "-c", lead], stdin=far, stdout=far, stderr=far, pass_fds=[far], env=environment
    )
    os.close(far)
    try:
        yield process, near
    finally:
        process.kill()
        process.wait()


class ScreenOutput:
    """What a screen has drawn.

    Attributes:
        seen: all of it.
    """

    def __init__(self, terminal: int) -> None:
        self._terminal = terminal
        self.seen = b""

    def until(self, wanted: bytes) -> None:
        """Wait until something is drawn that was not drawn before."""
        begin, end = len(self.seen), time.monotonic() + LIMIT
        while wanted not in self.seen[max(0, begin - len(wanted)) :]:
            ready, _, _ = select.select([self._terminal], [], [], max(0, end - time.monotonic()))
            assert ready, self.seen[-3000:]
            self.seen += os.read(self._terminal, 65536)

    def drain(self, process: subprocess.Popen[bytes]) -> None:
        """Read until the process has ended."""
        end = time.monotonic() + LIMIT
        while process.poll() is None and time.monotonic() < end:
            if select.select([self._terminal], [], [], 0.1)[0]:
                try:
                    self.seen += os.read(self._terminal, 65536)
                except OSError:  # the other end is closed
                    return
