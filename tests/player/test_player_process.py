"""The player's process against a simulator on real sockets, as the command line and the screen use it."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.player.player_messages import (
    FrameMessage,
    PlayerMessage,
    PlayerProblem,
    PlayerQuestion,
    PlayOutcome,
    PlayPlan,
    PlayProgress,
)
from bcapscope.player.player_process import PlayerProcess
from bcapscope.player.realtime import RealtimeReport
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.simulator_server import SimulatorServer
from tests.player.simulated import wave

M = TypeVar("M", bound=PlayerMessage)
PATIENCE = 30.0


class Sim:
    """A simulator that serves in a thread.

    Attributes:
        machine: its controller.
        port: where it listens.
    """

    def __init__(self) -> None:
        simulator = Simulator(PROFILES["rc8"], now=time.monotonic_ns())
        self.machine: Machine = simulator.machine
        self._server = SimulatorServer(simulator, "127.0.0.1", 0)
        self.port = self._server.address[1]
        self._over = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self) -> None:
        """End it; may be called again."""
        self._over = True
        self._thread.join()

    def _serve(self) -> None:
        while not self._over:
            self._server.step(0.05)
        self._server.close()

    def wait(self, condition: Callable[[], bool]) -> None:
        """Wait until something is true of the controller."""
        give_up = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < give_up
            time.sleep(0.01)


@pytest.fixture
def sim() -> Iterator[Sim]:
    made = Sim()
    yield made
    made.close()


def plan(sim: Sim, **more: object) -> PlayPlan:
    """Make a plan that takes eight seconds unless it is stopped.

    Over TCP and in a mode that forgives, since a simulator in a thread of a busy machine may be late.
    """
    usual = {
        "mode": 0x102,
        "points": wave(1000, 0.5),
        "target": ControllerTarget("127.0.0.1", sim.port, tcp=True),
    }
    return PlayPlan(**{**usual, **more})  # type: ignore[arg-type]


def until(player: PlayerProcess, kind: type[M], also: Callable[[M], bool] = lambda _: True) -> M:
    """Read messages until one of a kind comes; begin when asked."""
    give_up = time.monotonic() + PATIENCE
    while time.monotonic() < give_up:
        for message in player.wait_for_messages(1.0):
            if isinstance(message, PlayerQuestion):
                player.answer("yes")
            if isinstance(message, kind) and also(message):
                return message
        assert player.ended is None, player.ended
    raise AssertionError(f"no {kind.__name__} came")


def playing(player: PlayerProcess) -> PlayProgress:
    """Wait until the robot moves."""
    return until(player, PlayProgress, lambda message: message.index > 50)


def test_it_plays_and_tells(sim: Sim, tmp_path: Path) -> None:
    log, record = tmp_path / "log.csv", tmp_path / "all.pcapng"
    chosen = plan(sim, points=wave(100, 0.1), log=str(log), record=str(record))
    messages: list[PlayerMessage] = []
    with PlayerProcess(chosen) as player:
        while player.ended is None:
            for message in player.wait_for_messages(PATIENCE):
                messages.append(message)
                if isinstance(message, PlayerQuestion):
                    player.answer("yes")
    ended = player.ended
    assert (ended.outcome, str(ended.reason or ""), ended.index) == (PlayOutcome.DONE, "", 100)
    assert messages[-1] is ended
    assert {type(message).__name__ for message in messages} >= {
        "RealtimeReport",
        "ControllerInfo",
        "FrameMessage",
        "PlayProgress",
    }
    shown = [message for message in messages if isinstance(message, PlayProgress) and message.commanded]
    assert len(shown) > 5
    assert len(shown[-2].returned) == 8
    assert log.read_text(encoding="utf-8").count("\n") == ended.logged + 1 > 50  # less if held up
    assert record.stat().st_size > 100 * 150
    assert sim.machine.slave.mode is None


def test_a_stop_ends_it_in_order(sim: Sim) -> None:
    with PlayerProcess(plan(sim)) as player:
        playing(player)
        player.stop()
    assert player.ended is not None
    assert (player.ended.outcome, str(player.ended.reason or "")) == (
        PlayOutcome.STOPPED,
        "stop was requested",
    )
    assert player.ended.left
    assert not sim.machine.active_alarms


@pytest.mark.lifecycle
def test_a_halt_ends_it_at_once(sim: Sim) -> None:
    with PlayerProcess(plan(sim)) as player:
        playing(player)
        player.halt()
        sim.wait(lambda: sim.machine.stop_count > 0)
    assert player.ended is not None
    assert player.ended.outcome is PlayOutcome.HALTED


def test_a_halt_counts_that_comes_while_the_player_is_being_loaded(sim: Sim) -> None:
    with PlayerProcess(plan(sim)) as player:
        player.halt()
        until_ended(player)
    assert player.ended is not None
    assert (player.ended.outcome, str(player.ended.reason or "")) == (
        PlayOutcome.HALTED,
        "halt was requested",
    )
    assert player.ended.left


@pytest.mark.lifecycle
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signals_stop_it_too(sim: Sim, number: signal.Signals) -> None:
    with PlayerProcess(plan(sim)) as player:
        playing(player)
        os.kill(player.pid, number)
        stopping = until(player, PlayProgress, lambda message: message.state == "coming to rest")
        assert stopping.commanded
    assert player.ended is not None
    assert (player.ended.outcome, str(player.ended.reason or "")) == (
        PlayOutcome.STOPPED,
        f"{number.name} was received",
    )


_PARENT = """
import sys
from bcapscope.client.controller_target import ControllerTarget
from bcapscope.player.player_messages import PlayerQuestion, PlayPlan, PlayProgress
from bcapscope.player.player_process import PlayerProcess
from tests.player.simulated import wave

target = ControllerTarget("127.0.0.1", int(sys.argv[1]), True)
player = PlayerProcess(PlayPlan(target=target, mode=0x102, points=wave(1000, 0.5)))
while True:
    for message in player.wait_for_messages(1.0):
        if isinstance(message, PlayerQuestion):
            player.answer("yes")
        if isinstance(message, PlayProgress) and message.index > 50:
            print(player.pid, flush=True)
"""


@pytest.mark.lifecycle
def test_when_the_program_that_started_it_is_killed_the_robot_comes_to_rest(sim: Sim) -> None:
    argv = [sys.executable, "-c", _PARENT, str(sim.port)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert int(parent.stdout.readline())
        assert sim.machine.slave.mode is not None
        parent.kill()
        parent.stdout.close()
    all_is_let_go(sim)


def all_is_let_go(sim: Sim) -> None:
    """Wait until the controller is as it was before anybody came."""
    machine = sim.machine
    sim.wait(lambda: machine.slave.mode is None and machine.owner is None and not machine.open_objects)
    assert not machine.motor_is_on(time.monotonic_ns())
    assert not machine.active_alarms


def test_nobody_reading_delays_nothing(sim: Sim) -> None:
    with PlayerProcess(plan(sim, points=wave(250, 0.2))) as player:
        fcntl.fcntl(player, fcntl.F_SETPIPE_SZ, 4096)
        playing(player)
        sim.wait(lambda: sim.machine.slave.mode is None)
    assert player.ended is not None
    assert player.ended.outcome is PlayOutcome.DONE
    assert not sim.machine.active_alarms


def test_a_controller_that_is_killed_is_told(sim: Sim) -> None:
    with PlayerProcess(plan(sim)) as player:
        playing(player)
        sim.close()
        until_ended(player)
    assert player.ended is not None
    assert (player.ended.outcome, player.ended.left) == (PlayOutcome.UNANSWERED, False)


def until_ended(player: PlayerProcess) -> None:
    """Read until the last message."""
    give_up = time.monotonic() + PATIENCE
    while player.ended is None:
        assert time.monotonic() < give_up
        player.wait_for_messages(1.0)


def test_a_tcp_port_where_nobody_listens() -> None:
    with PlayerProcess(PlayPlan(target=ControllerTarget("127.0.0.1", 1, tcp=True), mode=2)) as player:
        until_ended(player)
    assert player.ended is not None
    assert str(player.ended.reason or "") == "127.0.0.1:1 over TCP: connection refused"


def test_files_are_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("mine")
    with PlayerProcess(PlayPlan(target=ControllerTarget("127.0.0.1", 1), mode=2, log=str(path))) as player:
        until_ended(player)
    assert player.ended is not None
    assert (player.ended.outcome, str(player.ended.reason or "")) == (
        PlayOutcome.UNWRITABLE,
        f"{path}: file exists",
    )
    assert path.read_text() == "mine"


def test_a_player_that_is_killed_is_told(sim: Sim) -> None:
    with PlayerProcess(plan(sim)) as player:
        until(player, RealtimeReport)
        os.kill(player.pid, signal.SIGKILL)
        until_ended(player)
    assert player.ended is not None
    assert str(player.ended.reason or "") == "the player ended with signal 9"
    assert player.ended.left


@pytest.mark.parametrize("tcp", [False, True])
def test_what_a_player_had_begun_that_is_killed_is_ended_by_another(sim: Sim, tcp: bool) -> None:
    with PlayerProcess(plan(sim, target=ControllerTarget("127.0.0.1", sim.port, tcp=tcp))) as player:
        playing(player)
        first = player.pid
        os.kill(first, signal.SIGKILL)
        trouble = until(player, PlayerProblem)
        assert player.pid != first
        player.halt()
        until_ended(player)
    assert (
        str(trouble.text)
        == "the player ended with signal 9. Another process is ending what the player had begun"
    )
    assert player.ended is not None
    assert (player.ended.outcome, player.ended.left) == (PlayOutcome.FAILED, True)
    assert (
        str(player.ended.reason or "")
        == "the player ended with signal 9. Another process ended what the player had begun"
    )
    all_is_let_go(sim)


def test_a_player_that_is_killed_beside_its_controller_is_told_too(sim: Sim) -> None:
    with PlayerProcess(plan(sim)) as player:
        playing(player)
        os.kill(player.pid, signal.SIGSTOP)  # or it ends by itself when it finds its controller gone
        sim.close()
        os.kill(player.pid, signal.SIGKILL)
        until_ended(player)
    assert player.ended is not None
    assert not player.ended.left
    assert str(player.ended.reason or "").startswith(
        "the player ended with signal 9. What the player had begun could not be"
    )


def test_a_player_that_hangs_is_killed_when_it_is_to_end(sim: Sim, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.player.player_process._LEAVE_TIMEOUT", 0.5)
    player = PlayerProcess(plan(sim))
    playing(player)
    start = player._start

    def start_patiently(after: PlayPlan) -> None:
        monkeypatch.setattr("bcapscope.player.player_process._LEAVE_TIMEOUT", PATIENCE)
        start(after)

    monkeypatch.setattr(player, "_start", start_patiently)
    os.kill(player.pid, signal.SIGSTOP)
    ended = player.close()
    assert "signal 9" in str(ended.reason or "")
    all_is_let_go(sim)


def test_files_to_which_nothing_was_written_are_not_left(tmp_path: Path) -> None:
    paths = tmp_path / "log.csv", tmp_path / "all.pcapng"
    target = ControllerTarget("127.0.0.1", 1, tcp=True)
    with PlayerProcess(PlayPlan(target=target, mode=2, log=str(paths[0]), record=str(paths[1]))) as player:
        until_ended(player)
    assert not any(path.exists() for path in paths)


def test_frames_are_told_outside_of_the_pace(sim: Sim) -> None:
    with PlayerProcess(plan(sim, look_only=True)) as player:
        packet = until(player, FrameMessage)
        assert packet.sent
        assert packet.raw[9:11] == b"\x01\x00"
