"""What the player's process does besides its session."""

from __future__ import annotations

import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bcapscope.capture.rotating_recording import RotatingRecording
from bcapscope.client.controller_target import DEFAULT_RETRY_POLICIES, ControllerTarget
from bcapscope.client.remote_objects import Robot
from bcapscope.client.session import Session
from bcapscope.messages import Message
from bcapscope.player import __main__ as process
from bcapscope.player.blocking_caller import BlockingCaller, run_blocking
from bcapscope.player.control_log import read_log_records
from bcapscope.player.frame_recorder import FrameRecorder, open_recording
from bcapscope.player.player_messages import Order, PlayEnded, PlayOutcome, PlayPlan
from bcapscope.player.player_pipe import PARENT_GONE
from bcapscope.player.realtime import RealtimeReport
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from tests.player.simulated import TARGET, ScriptedPipe, Stage

pytestmark = pytest.mark.lifecycle


def test_files_are_written_without_priority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urgent = False
    written: list[bool] = []

    @contextmanager
    def undisturbed(wanted: bool) -> Iterator[RealtimeReport]:
        nonlocal urgent
        urgent = True
        yield RealtimeReport(True, True, Message("play.realtime.off"))
        urgent = False

    def flush(recording: RotatingRecording) -> None:
        written.append(urgent)
        write(recording)

    write = RotatingRecording.flush
    monkeypatch.setattr(process, "realtime_priority", undisturbed)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent,
        open_recording(str(tmp_path / "a.pcapng")) as recording,
    ):
        monkeypatch.setattr(RotatingRecording, "flush", flush)
        silent.bind(("127.0.0.1", 0))
        target = ControllerTarget("127.0.0.1", silent.getsockname()[1], timeout=1.0, retries=0)
        ended = process.play(PlayPlan(target=target, look_only=True), ScriptedPipe(), recording, None)
    assert (ended.outcome, ended.realtime) == (PlayOutcome.UNANSWERED, True)
    assert written
    assert not any(written)


@pytest.mark.parametrize("ordered", [True, False])
def test_an_order_ends_the_reading_of_the_log(ordered: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    async def execute(robot: Robot, command: str, parameter: object = None) -> int | str:
        return 9 if command == "GetLogCount" else f"record {parameter}"

    monkeypatch.setattr(Robot, "execute", execute)
    stage, pipe, log = Stage(), ScriptedPipe(), io.BytesIO()
    pipe.set_order(Order.STOP, PARENT_GONE)
    pipe.at_poll = lambda count: Order.HALT if ordered and count > 5 else None
    session, look = (
        Session(BlockingCaller(stage.channel, ReservedConvention.SEED), DEFAULT_RETRY_POLICIES),
        process.abort_on_order(pipe),
    )
    ended = process.write_files(
        PlayEnded(PlayOutcome.STOPPED),
        FrameRecorder(pipe.send, None),
        stage.channel,
        log,
        lambda: run_blocking(read_log_records(session, TARGET, "Arm", look)),
    )
    assert stage.calls[-1] == "Service_Stop"
    if ordered:
        told = "the log could not be written: an order to stop arrived first"
        assert (ended.outcome, str(ended.reason or ""), log.getvalue()) == (PlayOutcome.UNWRITABLE, told, b"")
    else:
        assert (ended.outcome, ended.logged, log.getvalue()[-9:]) == (PlayOutcome.STOPPED, 9, b"record 8\n")
