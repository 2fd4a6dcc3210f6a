"""Reading live traffic for a command."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator

import pytest

from bcapscope.capture.packet import Interface, Packet
from bcapscope.cli.common import capture_reader
from bcapscope.cli.common.capture_reader import CaptureReader
from tests.capture.packets import from_client, request


class FakeCapture:
    """A live capture of some packets, with silence between them."""

    lost = 0

    def __init__(self, *packets: bytes | None) -> None:
        self.on_idle: Callable[[], None] = lambda: None
        self._packets = packets

    def __enter__(self) -> FakeCapture:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Packet]:
        for number, data in enumerate(self._packets):
            if data is None:
                self.on_idle()
            else:
                yield number * 10**9, data, len(data), Interface(1), ()


def reader_of(monkeypatch: pytest.MonkeyPatch, *packets: bytes | None) -> CaptureReader:
    monkeypatch.setattr(capture_reader, "open_live_capture", lambda name: FakeCapture(*packets))
    return CaptureReader((), (), "eth0")


def test_silence_and_other_traffic_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = reader_of(monkeypatch, from_client(request(1)), None, b"no b-CAP", from_client(request(2)))
    events: list[object] = []
    reader.on_idle = lambda now: events.append("live" if now > 10**18 else now // 10**9)
    for observation in reader.observations():
        events.append(f"frame {observation.number}")
    assert events == [0, "frame 1", "live", 2, 3, "frame 2"]


def test_ctrl_c_takes_effect_after_the_work_of_a_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = reader_of(monkeypatch, from_client(request(1)), None, from_client(request(2)))
    finished = []

    def work(now: int) -> None:
        if now > 10**18:
            os.kill(os.getpid(), signal.SIGINT)
            finished.append(True)

    reader.on_idle = work
    assert [observation.number for observation in reader.observations()] == [1]
    assert finished == [True]


def test_what_is_live(monkeypatch: pytest.MonkeyPatch) -> None:
    assert reader_of(monkeypatch).is_live
    assert not CaptureReader(("a.pcap",), ()).is_live
