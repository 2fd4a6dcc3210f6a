"""The recorder, and what it does when the disk fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.rotating_recording import RotationLimits
from bcapscope.errors import FileWriteError
from bcapscope.live.recorder import Recorder
from tests.capture.test_rotating_recording import SmallDisk
from tests.english import collects

CLIENT, SERVER = ("10.0.0.2", 50001), ("10.0.0.1", 5007)


def write(recorder: Recorder, count: int) -> None:
    for number in range(count):
        recorder.begin_packet()
        recorder.packets.write_datagram(CLIENT, SERVER, bytes(500), number)
        recorder.flush()


@pytest.mark.lifecycle
def test_a_file_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    path.write_bytes(b"mine")
    with pytest.raises(FileWriteError, match="file exists"):
        Recorder(path, lambda text: None)
    assert path.read_bytes() == b"mine"


@pytest.mark.parametrize("ring", [None, RotationLimits(3, size=100_000)])
def test_a_disk_that_fails_is_reported_once_and_packets_are_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ring: RotationLimits | None
) -> None:
    SmallDisk(tmp_path, 8_000, monkeypatch)
    told: list[str] = []
    recorder = Recorder(tmp_path / "a.pcapng", collects(told), ring)
    write(recorder, 100)
    recorder.close()
    recorder.packets.write_datagram(CLIENT, SERVER, b"x", 1)
    assert told == [f"recording to {tmp_path}/a.pcapng stopped: no space left on device"]
    assert not recorder.is_complete
    assert not recorder.files.bytes_pending
    (path,) = tmp_path.iterdir()
    with open_capture(str(path)) as capture:
        assert 5 < len(list(capture)) < 20


def test_a_ring_whose_next_file_cannot_be_created_is_reported(tmp_path: Path) -> None:
    told: list[str] = []
    folder = tmp_path / "gone"
    folder.mkdir()
    recorder = Recorder(folder / "a.pcapng", collects(told), RotationLimits(3, size=10_000))
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    write(recorder, 100)
    recorder.close()
    assert told == [f"recording to {folder}/a.pcapng stopped: no such file or directory"]
    assert not recorder.is_complete
