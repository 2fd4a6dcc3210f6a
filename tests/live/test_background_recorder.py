"""A capture that is written behind the server's back, by disks that are slow, stuck or full."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from io import BytesIO, FileIO, RawIOBase
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from bcapscope.capture.capture_file import open_capture as captured
from bcapscope.capture.rotating_recording import RotatingRecording
from bcapscope.live import background_recorder as module
from bcapscope.live.background_recorder import MAX_WAITING, BackgroundRecorder
from bcapscope.live.recorder import Recorder
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from tests.cli.run import run
from tests.english import collects

CLIENT, SERVER = ("10.0.0.2", 50001), ("10.0.0.1", 5007)
TIME = 1_700_000_000_000_000_000
REQUEST, REPLY = encode_frame(7, 0, 2), encode_frame(7, 0, 0)


class Disk(RawIOBase):
    """A disk that takes nothing but the file header until it is told to, and then a few bytes at a time."""

    def __init__(self) -> None:
        self.taken = BytesIO()
        self.runs = Event()

    def write(self, data: object) -> int:
        """Take some bytes."""
        assert isinstance(data, bytes | memoryview)
        if self.taken.tell():
            self.runs.wait(30)
        return self.taken.write(bytes(data)[:100])

    def close(self) -> None:
        """Stay readable."""


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something is true."""
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def catch_up(disk: Disk, recorder: BackgroundRecorder) -> None:
    """Let a disk run, and wait until it has taken all that waits."""
    disk.runs.set()
    wait_for(lambda: not recorder._recorder.files.bytes_pending)


MakeRecorder = Callable[..., BackgroundRecorder]


@pytest.fixture
def record_on(monkeypatch: pytest.MonkeyPatch) -> MakeRecorder:
    """Return a function that makes a recorder whose file is on a given disk."""

    def make(
        disk: RawIOBase, told: list[str], most_waiting: int = MAX_WAITING, name: str = "a.pcapng"
    ) -> BackgroundRecorder:
        monkeypatch.setattr(RotatingRecording, "_create_file", lambda files, path: disk)
        monkeypatch.setattr(module, "MAX_WAITING", most_waiting)
        return BackgroundRecorder(Recorder(Path(name), collects(told)))

    return make


def frames(path: Path, data: bytes) -> tuple[int, str, list[str]]:
    """Decode a capture; return the exit code, stderr, and the lines."""
    path.write_bytes(data)
    ran = run("decode", path)
    return ran.code, ran.err, ran.lines


def test_what_is_taken_is_written(tmp_path: Path) -> None:
    path, told = tmp_path / "a.pcapng", list[str]()
    recorder = BackgroundRecorder(Recorder(path, collects(told)))
    recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME)
    recorder.on_segment(CLIENT, SERVER, REQUEST, TIME + 1)
    recorder.on_connection_end(CLIENT, SERVER)
    recorder.on_idle()
    wait_for(lambda: path.stat().st_size > 200)
    recorder.on_datagram(SERVER, CLIENT, REPLY, TIME + 2)
    assert recorder.close()
    assert told == []
    assert len(frames(path, path.read_bytes())[2]) == 3


def test_packets_are_made_for_a_while_only_before_the_server_looks_around(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_MAKE_FOR_NS", 1)
    path = tmp_path / "a.pcapng"
    recorder = BackgroundRecorder(Recorder(path, lambda text: None))
    for number in range(5):
        recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME + number)
    assert recorder.on_idle()
    assert len(recorder._steps) >= 3
    assert recorder.close()
    assert len(frames(path, path.read_bytes())[2]) == 5


def test_a_stuck_disk_holds_nobody_up_and_what_is_missing_is_told_and_noted(
    tmp_path: Path, record_on: MakeRecorder
) -> None:
    disk, told = Disk(), list[str]()
    recorder = record_on(disk, told, most_waiting=50_000)
    began = time.monotonic()
    for number in range(1000):
        recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME + number)
        recorder.on_idle()
    assert time.monotonic() - began < 5
    assert told == ["the disk is too slow for a.pcapng: from now on, packets are missing in it"]
    kept = 1000 - recorder._skipped
    assert 50 < kept < 120
    catch_up(disk, recorder)
    recorder.on_datagram(SERVER, CLIENT, REPLY, TIME + 1000)
    assert not recorder.close()
    assert told[1:] == [f"a.pcapng lacks {1000 - kept} packets, because the disk was too slow"]
    code, _, lines = frames(tmp_path / "a.pcapng", disk.taken.getvalue())
    assert (code, len(lines)) == (0, kept + 1)
    comment = f"missing before this packet: {1000 - kept} packets, not written in time"
    assert comment.encode() in disk.taken.getvalue()


def test_bytes_of_a_connection_that_are_missing_are_a_gap(tmp_path: Path, record_on: MakeRecorder) -> None:
    disk, told = Disk(), list[str]()
    recorder = record_on(disk, told, most_waiting=5_000)
    for number in range(100):
        recorder.on_segment(CLIENT, SERVER, REQUEST, TIME + number)
        recorder.on_idle()
    kept = 100 - recorder._skipped
    assert 3 < kept < 12
    catch_up(disk, recorder)
    recorder.on_segment(CLIENT, SERVER, REQUEST, TIME + 100)
    assert not recorder.close()
    _, _, lines = frames(tmp_path / "a.pcapng", disk.taken.getvalue())
    gaps = [line for line in lines if f"{(100 - kept) * len(REQUEST)} bytes" in line]
    assert len(lines) == kept + 2
    assert len(gaps) == 1, lines


def test_the_ends_of_a_connection_are_written_if_the_rest_is(tmp_path: Path) -> None:
    path, told = tmp_path / "a.pcapng", list[str]()
    recorder = BackgroundRecorder(Recorder(path, collects(told)))
    recorder.on_stream_end(CLIENT, SERVER, TIME)
    recorder.on_segment(CLIENT, SERVER, REQUEST, TIME + 1)
    recorder.on_stream_end(CLIENT, SERVER, TIME + 2)
    recorder.on_stream_end(SERVER, CLIENT, TIME + 3, reset=True)
    recorder.on_connection_end(CLIENT, SERVER)
    recorder.on_stream_end(CLIENT, SERVER, TIME + 4)
    assert recorder.close()
    with captured(str(path)) as capture:
        assert [(packet[0] - TIME, packet[1][33]) for packet in capture] == [(1, 24), (2, 17), (3, 20)]


def test_a_connection_that_ended_unseen_is_forgotten(record_on: MakeRecorder) -> None:
    disk = Disk()
    recorder = record_on(disk, [], most_waiting=5_000)
    for number in range(100):
        recorder.on_segment(CLIENT, SERVER, REQUEST, TIME + number)
        recorder.on_idle()
    recorder.on_connection_end(CLIENT, SERVER)
    for port in range(1000):
        recorder.on_segment((CLIENT[0], port), SERVER, REQUEST, TIME)
        recorder.on_connection_end((CLIENT[0], port), SERVER)
    assert len(recorder._steps) == 1
    assert not recorder._gap_bytes
    disk.runs.set()
    recorder.close()


def test_a_disk_that_is_stuck_for_good_does_not_hold_up_the_end(
    monkeypatch: pytest.MonkeyPatch, record_on: MakeRecorder
) -> None:
    monkeypatch.setattr(module, "_ENDS_WITHIN", 0.05)
    disk, told = Disk(), list[str]()
    recorder = record_on(disk, told)
    for _ in range(3):
        recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME)
        recorder.on_idle()
    assert not recorder.close()
    assert told == ["a.pcapng lacks 3 packets, because the disk was too slow"]
    disk.runs.set()


class SmallDisk(FileIO):
    """A file on a disk with room for so many bytes."""

    def __init__(self, path: Path, size: int) -> None:
        super().__init__(path, "x")
        self.size = size

    def write(self, data: Any, /) -> int:
        room = self.size - self.tell()
        if not room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data[:room])


def test_a_full_disk_is_told_once_and_the_rest_goes_on(tmp_path: Path, record_on: MakeRecorder) -> None:
    told = list[str]()
    recorder = record_on(SmallDisk(tmp_path / "a.pcapng", 28), told, name="a\x1b.pcapng")
    recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME)
    recorder.on_idle()
    wait_for(lambda: bool(told))
    for _ in range(3):
        recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME)
        recorder.on_segment(CLIENT, SERVER, REQUEST, TIME)
        recorder.on_connection_end(CLIENT, SERVER)
        recorder.on_idle()
    assert not recorder._steps
    assert not recorder._recorder.files.bytes_pending
    assert not recorder.close()
    assert told == ["recording to a\\x1b.pcapng stopped: no space left on device"]


def test_a_capture_on_a_full_disk_ends_with_a_whole_packet(tmp_path: Path, record_on: MakeRecorder) -> None:
    told = list[str]()
    recorder = record_on(SmallDisk(tmp_path / "a.pcapng", 5001), told)
    while not told:
        recorder.on_datagram(CLIENT, SERVER, REQUEST, TIME)
        recorder.on_idle()
        time.sleep(0.001)
    assert not recorder.close()
    with captured(str(tmp_path / "a.pcapng")) as capture:
        assert len(list(capture)) > 10


def seen(transport: Transport, direction: Direction, number: int) -> Observation:
    conversation = Conversation(Endpoint(*CLIENT), Endpoint(*SERVER), transport, SERVER_PORT)
    item = Frame(encode_frame(number, 0, 1 if direction is Direction.REQUEST else 0))
    return Observation(number, TIME + number, TIME + number, Flow(conversation, direction), item, 0)


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_what_passed_is_read_as_it_was(tmp_path: Path, transport: Transport) -> None:
    recorder = BackgroundRecorder(Recorder(tmp_path / "a.pcapng", lambda text: None))
    for number in range(1, 4):
        for direction in Direction:
            recorder.on_observation(seen(transport, direction, number))
    wait_for(lambda: not recorder._recorder.files.bytes_pending)
    lines = run("calls", tmp_path / "a.pcapng").lines
    assert len(lines) == 3
    assert all("Service_Start" in line and "S_OK" in line and str(transport) in line for line in lines)
    recorder.close()
    recorder.on_observation(seen(transport, Direction.REQUEST, 9))
    assert len(run("calls", tmp_path / "a.pcapng").lines) == 3
