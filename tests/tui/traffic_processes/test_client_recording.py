"""What a client of ours says, as a capture."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.tui.traffic_processes.client_recording import ClientRecording
from tests.cli.run import run

TIME = 1_700_000_000_123_456_789


def seen(transport: Transport, direction: Direction, number: int) -> Observation:
    conversation = Conversation(Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007), transport, "")
    item = Frame(encode_frame(number, 0, 1 if direction is Direction.REQUEST else 0))
    return Observation(number, TIME + number, TIME + number, Flow(conversation, direction), item, 0)


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_what_passed_is_read_as_it_was(tmp_path: Path, transport: Transport) -> None:
    tap = ClientRecording(tmp_path / "a.pcapng")
    for number in range(1, 4):
        for direction in Direction:
            tap.write_observation(seen(transport, direction, number))
    lines = run("calls", tmp_path / "a.pcapng").lines
    assert len(lines) == 3
    assert all("Service_Start" in line and "S_OK" in line and str(transport) in line for line in lines)
    tap.close()
    tap.write_observation(seen(transport, Direction.REQUEST, 9))
    assert len(run("calls", tmp_path / "a.pcapng").lines) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="there is no such device")
def test_a_full_disk_does_not_disturb(tmp_path: Path) -> None:
    tap = ClientRecording(tmp_path / "a.pcapng")
    tap._file.close()
    with open("/dev/full", "wb", buffering=0) as full:
        tap._recording._writer._file = full  # type: ignore[union-attr]  # as if the disk were full by now
        tap.write_observation(seen(Transport.UDP, Direction.REQUEST, 1))
        tap.write_observation(seen(Transport.UDP, Direction.REQUEST, 2))
    assert tap._recording is None
