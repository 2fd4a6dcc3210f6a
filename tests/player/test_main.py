"""What the player's process does besides its visit."""

from __future__ import annotations

import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bcapscope.client.target import Target
from bcapscope.player import __main__ as process
from bcapscope.player.messages import Outcome, Plan
from bcapscope.player.realtime import Grade
from tests.player.simulated import ScriptedDesk


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
