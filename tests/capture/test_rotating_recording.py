"""A recording in one file, or in a ring of them."""

from __future__ import annotations

import errno
import io
import resource
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet import Packet
from bcapscope.capture.rotating_recording import RotatingRecording, RotationLimits, parse_rotation

pytestmark = pytest.mark.lifecycle

CLIENT, SERVER = ("10.0.0.2", 50001), ("10.0.0.1", 5007)


def packets(path: Path) -> list[Packet]:
    with open_capture(str(path)) as capture:
        return list(capture)


def write(series: RotatingRecording, count: int) -> None:
    for number in range(count):
        series.recording.write_datagram(CLIENT, SERVER, bytes(333), number)
        series.flush()


@pytest.mark.parametrize(
    ("text", "bounds"),
    [
        ("10x100MB", RotationLimits(10, 100_000_000)),
        ("2x10kB", RotationLimits(2, 10_000)),
        ("24x1h", RotationLimits(24, 0, 3600)),
        ("3x5min,1GB", RotationLimits(3, 10**9, 300)),
    ],
)
def test_bounds(text: str, bounds: RotationLimits) -> None:
    assert parse_rotation(text) == bounds


@pytest.mark.parametrize(
    "text",
    ["", "10", "x1MB", "1x1MB", "3x", "3x1", "3x1MB,", "3x1MB,2MB", "3x0s", "3x5kB", "٣x1MB", "3x1 MB"],
)
def test_no_bounds(text: str) -> None:
    with pytest.raises(ValueError, match=r"ring|size|second"):
        parse_rotation(text)


def test_nothing_is_there_before_it_is_flushed(tmp_path: Path) -> None:
    series = RotatingRecording(tmp_path / "a.pcapng")
    series.recording.write_datagram(CLIENT, SERVER, b"one", 1)
    series.flush()
    series.recording.write_datagram(CLIENT, SERVER, b"two", 2)
    assert [packet[1][28:] for packet in packets(tmp_path / "a.pcapng")] == [b"one"]
    series.flush()
    series.recording.write_datagram(CLIENT, SERVER, b"three", 3)
    series.close()
    assert len(packets(tmp_path / "a.pcapng")) == 2


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.pcapng").write_bytes(b"mine")
    with pytest.raises(FileExistsError):
        RotatingRecording(tmp_path / "a.pcapng")


@pytest.mark.parametrize("path", ["there/a.pcapng", "missing/a.pcapng"])
def test_a_file_that_cannot_be_opened_leaves_nothing_to_close(tmp_path: Path, path: str) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "a.pcapng").touch()
    source = (
        "import sys\nfrom pathlib import Path\n"
        "from bcapscope.capture.rotating_recording import RotatingRecording\n"
        "try:\n    RotatingRecording(Path(sys.argv[1]))\nexcept OSError:\n    print('refused')\n"
    )
    # Python older than 3.13 keeps errors of a finalizer to itself except in development mode.
    argv = [sys.executable, "-X", "dev", "-c", source, str(tmp_path / path)]
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("refused\n", "")


def test_a_file_of_a_ring_is_too_large_by_less_than_a_packet_however_many_are_flushed_at_once(
    tmp_path: Path,
) -> None:
    series, size = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(9, size=20_000)), 1000
    for number in range(100):
        series.rotate_if_full()
        series.recording.write_datagram(CLIENT, SERVER, bytes(size), number)
    series.flush()
    series.close()
    sizes = [path.stat().st_size for path in series.paths]
    assert len(sizes) == 6
    assert all(20_000 <= each < 20_000 + size + 100 for each in sizes[:-1])
    assert [packet[0] for path in series.paths for packet in packets(path)] == list(range(100))


def test_the_oldest_of_a_ring_are_removed_and_each_can_be_read_alone(tmp_path: Path) -> None:
    series = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(3, size=20_000))
    for number in range(100):
        series.rotate_if_full()
        series.recording.write_datagram(CLIENT, SERVER, number.to_bytes(2) * 500, number)
        series.flush()
    series.close()
    assert sorted(series.paths) == sorted(tmp_path.iterdir())
    assert [path.name[:8] for path in series.paths] == ["a_00004_", "a_00005_", "a_00006_"]
    found = [packet[0] for path in series.paths for packet in packets(path)]
    assert found == list(range(100 - len(found), 100))
    assert all(path.stat().st_size < 22_000 for path in series.paths)


def test_a_ring_by_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("bcapscope.capture.rotating_recording.time.monotonic", lambda: now[0])
    series = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(5, seconds=60))
    now[0] += 10_000  # it begins with its first packet
    for number in range(10):
        now[0] += 25
        series.rotate_if_full()
        series.recording.write_datagram(CLIENT, SERVER, b"x", number)
        series.flush()
        series.flush()  # of nothing, makes no file
    series.close()
    assert [len(packets(path)) for path in series.paths] == [3, 3, 3, 1]


def test_no_file_of_a_ring_is_empty(tmp_path: Path) -> None:
    series = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(3, size=10_000))
    for number in range(2):
        series.rotate_if_full()
        series.recording.write_datagram(CLIENT, SERVER, bytes(10_000), number)
        series.flush()
    series.close()
    assert [len(packets(path)) for path in series.paths] == [1, 1]


def test_where_there_is_no_room_the_file_ends_with_a_whole_block(tmp_path: Path) -> None:
    series = RotatingRecording(tmp_path / "a.pcapng")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write(series, 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    series.close()
    assert 20 < len(packets(tmp_path / "a.pcapng")) < 30


class SmallDisk:
    """Lets the files of a folder hold so many bytes together, as a small disk does.

    A write that finds less room takes what fits, and the next one fails, as on Linux.
    """

    def __init__(self, folder: Path, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.size = size
        self._open = Path.open

        def open_here(path: Path, mode: str = "r", **names: Any) -> object:
            return self.open(path) if mode == "xb" else self._open(path, mode, **names)

        def disk_usage(_: Path) -> SimpleNamespace:
            return SimpleNamespace(free=self.free)

        monkeypatch.setattr(Path, "open", open_here)
        monkeypatch.setattr("bcapscope.capture.rotating_recording.shutil.disk_usage", disk_usage)

    @property
    def free(self) -> int:
        return self.size - sum(each.stat().st_size for each in self.folder.iterdir())

    def open(self, path: Path) -> io.FileIO:
        disk = self

        class OnDisk(io.FileIO):
            def write(self, data: Any, /) -> int:
                room = min(disk.free, len(data))
                if room <= 0:
                    raise OSError(errno.ENOSPC, "No space left on device")
                return super().write(data[:room])

        return OnDisk(path, "x")


def test_a_ring_on_a_full_disk_removes_its_oldest_file_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = SmallDisk(tmp_path, 100_000, monkeypatch)
    series = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(10, size=50_000))
    for number in range(1000):
        series.rotate_if_full()
        series.recording.write_datagram(CLIENT, SERVER, number.to_bytes(2) * 500, number)
        series.flush()
        assert disk.free >= 0
    series.close()
    assert series.files_freed
    assert sorted(series.paths) == sorted(tmp_path.iterdir())
    found = [packet[0] for path in series.paths for packet in packets(path)]
    assert found == list(range(1000 - len(found), 1000))
    assert len(found) * 1000 > 40_000


def test_a_disk_that_is_filled_by_others_leaves_a_ring_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = SmallDisk(tmp_path, 1_000_000, monkeypatch)
    series = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(5, size=20_000))
    for number in range(100):
        if number == 50:
            disk.size = 60_000  # others have taken the rest
        series.rotate_if_full()
        series.recording.write_datagram(CLIENT, SERVER, bytes(1000), number)
        series.flush()
    series.close()
    found = [packet[0] for path in series.paths for packet in packets(path)]
    assert found == list(range(100 - len(found), 100))
    assert series.files_freed


def test_a_ring_with_no_file_to_remove_gives_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    SmallDisk(tmp_path, 5_000, monkeypatch)
    series = RotatingRecording(tmp_path / "a.pcapng", RotationLimits(5, size=20_000))
    with pytest.raises(OSError, match="No space left"):
        write(series, 100)
    series.close()
    assert 5 < len(packets(tmp_path / series.paths[0])) < 15
    assert not series.files_freed


def test_one_file_on_a_full_disk_is_not_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    SmallDisk(tmp_path, 5_000, monkeypatch)
    series = RotatingRecording(tmp_path / "a.pcapng")
    with pytest.raises(OSError, match="No space left"):
        write(series, 100)
    series.close()
    assert len(packets(tmp_path / "a.pcapng")) > 5
