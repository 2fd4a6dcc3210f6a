"""What the player's process does besides its visit."""

from __future__ import annotations

import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bcapscope.client.objects import Robot
from bcapscope.client.paces import PACES
from bcapscope.client.session import Session
from bcapscope.client.target import Target
from bcapscope.player import __main__ as process
from bcapscope.player.controllog import read_records
from bcapscope.player.exchanger import BlockingExchanger, run
from bcapscope.player.journal import Journal
from bcapscope.player.messages import Ended, Order, Outcome, Plan
from bcapscope.player.realtime import Grade
from bcapscope.protocol.convention import Convention
from tests.player.simulated import TARGET, ScriptedDesk, Stage

pytestmark = pytest.mark.lifecycle


def test_files_are_written_without_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    urgent = False
    written: list[bool] = []

    @contextmanager
    def undisturbed(wanted: bool) -> Iterator[Grade]:
        nonlocal urgent
        urgent = True
        yield Grade(True, True, "")
        urgent = False

    class File(io.BytesIO):
        def write(self, data: object) -> int:
            written.append(urgent)
            return super().write(data)  # type: ignore[arg-type]

    monkeypatch.setattr(process, "undisturbed", undisturbed)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent, File() as record:
        silent.bind(("127.0.0.1", 0))
        target = Target("127.0.0.1", silent.getsockname()[1], timeout=1.0, retries=0)
        ended = process.play(Plan(target=target, look_only=True), ScriptedDesk(), record, None)
    assert (ended.outcome, ended.realtime) == (Outcome.UNANSWERED, True)
    assert written
    assert not any(written)


@pytest.mark.parametrize("ordered", [True, False])
def test_an_order_ends_the_reading_of_the_log(ordered: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    async def execute(robot: Robot, command: str, parameter: object = None) -> int | str:
        return 9 if command == "GetLogCount" else f"record {parameter}"

    monkeypatch.setattr(Robot, "execute", execute)
    stage, desk, log = Stage(), ScriptedDesk(), io.BytesIO()
    desk.note(Order.STOP, "while it played")
    desk.at_poll = lambda count: Order.HALT if ordered and count > 5 else None
    session, look = (
        Session(BlockingExchanger(stage.channel, Convention.SEED), PACES),
        process.until_ordered(desk),
    )
    ended = process.written(
        Ended(Outcome.STOPPED),
        Journal(desk.deliver, None),
        stage.channel,
        log,
        lambda: run(read_records(session, TARGET, "Arm", look)),
    )
    assert stage.said[-1] == "Service_Stop"
    if ordered:
        told = "the log could not be written: nobody waited for it"
        assert (ended.outcome, ended.reason, log.getvalue()) == (Outcome.UNWRITABLE, told, b"")
    else:
        assert (ended.outcome, ended.logged, log.getvalue()[-9:]) == (Outcome.STOPPED, 9, b"record 8\n")
