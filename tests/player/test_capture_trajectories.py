"""Set points out of captured traffic, stay by stay."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.pcapng_writer import PcapngWriter
from bcapscope.errors import CaptureError
from bcapscope.player.capture_trajectories import SOURCE_FORMAT, read_capture
from bcapscope.player.column_layout import ReadOptions
from bcapscope.player.trajectory import Trajectory, TrajectoryError, TrajectorySource
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.cli.run import CAPTURES
from tests.player.ways import texts


def read(name: str, wishes: ReadOptions | None = None) -> tuple[Trajectory, ...]:
    return read_capture(TrajectorySource(str(CAPTURES / name)), wishes or ReadOptions())


def test_a_stay() -> None:
    (found,) = read("slave-session.pcapng")
    assert found.points.shape == (240, 8)
    assert found.points[0].tolist() == [0, 0, 90, 0, 90, 0, 0, 0]
    assert found.points[-1].tolist() == [24, 15, 112, -18, 68, 36, 0, 0]
    assert (found.kind, found.period, found.source.file_format, found.source.part) == (
        PoseType.J,
        0.008,
        SOURCE_FORMAT,
        None,
    )
    assert [column.unit for column in found.source.columns] == ["deg"] * 8


def test_retries_count_once() -> None:
    (found,) = read("retry-story.pcapng")
    assert len(found) == 1


def test_what_was_refused_is_left_out_and_told() -> None:
    (found,) = read("slave-mode-lost.pcapng")
    assert len(found) == 30
    assert "left out: 3 refused by the controller" in texts(found.source.notes)


def test_each_stay_is_one_trajectory() -> None:
    found = read("exchanges.pcap")
    assert [str(each.source.part).split(",")[0] for each in found] == [
        "slave-mode session 1",
        "slave-mode session 2",
        "slave-mode session 3",
    ]
    assert [each.points.shape[1] for each in found] == [7, 8, 6]


@pytest.mark.parametrize(
    ("name", "wishes", "error"),
    [
        ("tcp-gap.pcap", ReadOptions(), "there are no set points"),
        ("slave-session.pcapng", ReadOptions(PoseType.T), "the set points are of type J, not T"),
    ],
)
def test_nothing_to_play(name: str, wishes: ReadOptions, error: str) -> None:
    with pytest.raises(TrajectoryError, match=error):
        read(name, wishes)


def broken(folder: Path, count: int) -> TrajectorySource:
    """Write the first packets of a session and a part of a block."""
    path = folder / "broken.pcapng"
    with open_capture(CAPTURES / "slave-session.pcapng") as packets, path.open("wb") as file:
        writer = PcapngWriter(file)
        for packet in islice(packets, count):
            writer.write(packet)
        file.write(b"\x06\0\0\0")
    return TrajectorySource(str(path))


def test_what_came_before_a_damage_is_kept(tmp_path: Path) -> None:
    (found,) = read_capture(broken(tmp_path, 200), ReadOptions())
    assert 10 < len(found) < 100
    assert any(
        note.startswith("the capture breaks off: the capture ends inside the block")
        for note in texts(found.source.notes)
    )


def test_a_capture_without_set_points_that_breaks_off(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="the capture ends inside the block"):
        read_capture(broken(tmp_path, 4), ReadOptions())
