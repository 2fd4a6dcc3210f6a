"""Files: every kind is recognised, and whatever is in one gives trajectories or one sentence."""

from __future__ import annotations

import gzip
import os
import struct
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.player import trajectory_documents, trajectory_reader
from bcapscope.player.column_layout import ReadOptions
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_documents import EXTRACT_FORMAT, MAX_VALUES
from bcapscope.player.trajectory_reader import (
    LONGEST_LINE,
    MAX_OBJECT_SIZE,
    MAX_TABLE_SIZE,
    read_trajectories,
)
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.cli.run import CAPTURES, run_here
from tests.player.test_column_layout import LOG
from tests.player.test_trajectory_table import log
from tests.player.ways import texts

TABLE = "J1,J2\n1,2\n3,4\n"


def write(path: Path, content: str | bytes, encoding: str = "utf-8") -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("encoding", "told"),
    [
        ("utf-8", "UTF-8"),
        ("utf-8-sig", "UTF-8 with byte order mark"),
        ("cp932", "Shift-JIS (cp932)"),
        ("utf-16", "UTF-16"),
        ("utf-16-le", "UTF-16"),
        ("utf-16-be", "UTF-16"),
    ],
)
def test_logs_in_every_encoding(tmp_path: Path, encoding: str, told: str) -> None:
    mark = "\ufeff" if encoding[6:] in ("-le", "-be") else ""
    (trajectory,) = read_trajectories(write(tmp_path / "log.csv", mark + log(range(0, 80, 8), LOG), encoding))
    assert trajectory.points.shape == (10, 8)
    assert str(trajectory.source.file_format) == f"control log, {told}"


def test_japanese_that_comes_late_is_read_as_well(tmp_path: Path) -> None:
    text = "J1,J2,file\n" + "1,2,a\n" * 5000 + "3,4,動作\n"
    (trajectory,) = read_trajectories(write(tmp_path / "way.csv", text, "cp932"))
    assert len(trajectory) == 5001
    assert str(trajectory.source.file_format) == "table, Shift-JIS (cp932)"


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_what_extract_writes_is_read_as_it_was(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"way{suffix}"
    run_here("extract", CAPTURES / "slave-session.pcapng", "-o", out)
    (extracted,) = read_trajectories(out)
    (direct,) = read_trajectories(CAPTURES / "slave-session.pcapng")
    assert np.array_equal(extracted.points, direct.points)
    assert (extracted.kind, extracted.period, extracted.times) == (PoseType.J, 0.008, None)
    assert (direct.kind, direct.period, direct.times) == (PoseType.J, 0.008, None)
    assert str(extracted.source.file_format).startswith("set points of bcapscope extract")


def test_several_stays_of_a_capture(tmp_path: Path) -> None:
    found = read_trajectories(CAPTURES / "two-robots.pcapng")
    assert [str(each.source.part).split(",")[0] for each in found] == [
        "slave-mode session 1",
        "slave-mode session 2",
    ]
    packed = write(tmp_path / "packed", gzip.compress((CAPTURES / "two-robots.pcapng").read_bytes()))
    assert len(read_trajectories(packed)) == 2


def test_a_capture_that_breaks_off_gives_what_it_has(tmp_path: Path) -> None:
    data = (CAPTURES / "slave-session.pcapng").read_bytes()
    (trajectory,) = read_trajectories(write(tmp_path / "cut.pcapng", data[: len(data) // 2 - 3]))
    assert 50 < len(trajectory) < 200
    assert any(note.startswith("the capture breaks off: ") for note in texts(trajectory.source.notes))


def test_a_capture_without_the_type_that_is_wished_for() -> None:
    with pytest.raises(TrajectoryError, match="of type J, not P"):
        read_trajectories(CAPTURES / "slave-session.pcapng", ReadOptions(PoseType.P))


@pytest.mark.parametrize("name", ["swing-joints.csv", "half-circle-positions.csv", "control-log.csv"])
def test_samples_have_the_interval(name: str) -> None:
    (trajectory,) = read_trajectories(CAPTURES / name)
    assert trajectory.period == 0.008


def test_way_points_of_ros() -> None:
    (trajectory,) = read_trajectories(CAPTURES / "joint-trajectory.yaml")
    assert trajectory.times is not None
    assert trajectory.times.tolist() == pytest.approx([0, 0.6, 1.4, 2, 3.5])
    assert trajectory.points[2].tolist() == pytest.approx(
        np.degrees([0.5, 0.3, 1.8, -0.4, 1.2, 0.7]).tolist()
    )


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("way.csv", "", "the file is empty"),
        ("way.csv", b"\x00\x01\x02", "the file is binary, of an unknown kind"),
        ("way.csv", b"\xff\xfe\x00", "this is not text in UTF-16"),
        ("way.csv", "J1,J2\n1,é\n".encode("latin-1"), "this is not text in UTF-8 or Shift-JIS (cp932)"),
        (
            "way.xlsx",
            b"PK\x03\x04....",
            "the file is a ZIP archive or an Excel workbook: save the sheet as CSV",
        ),
        ("bag.mcap", b"\x89MCAP0\r\n", "the file is an MCAP recording"),
        ("way.gz", gzip.compress(TABLE.encode(), mtime=0), "this is not a capture"),
        ("way.gz", b"\x1f\x8b\x08", ""),
        (
            "way.pcap",
            struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1),
            "there are no set points (slvMove)",
        ),
        ("way.json", "[1, 2", "line 1, column 6: this is not JSON: "),
        ("way.json", "[" * 10_000, "line 1, column 1026: this is not JSON: "),
        ("way.yaml", "[" * 900, "line 1, column 65: more than 64 levels"),
        ("way.yaml", "[" * 100_000, "line 1, column "),
        ("way.yaml", "a: [", "line 2, column 1: this is not YAML: "),
        ("way.csv", "1," * LONGEST_LINE, f"line 1: the line is longer than {LONGEST_LINE} characters"),
        ("way.csv", TABLE + "5," + "6" * LONGEST_LINE, "line 4: the line is longer"),
    ],
)
def test_hostile_files(tmp_path: Path, name: str, content: str | bytes, error: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        read_trajectories(write(tmp_path / name, content))
    assert str(caught.value).startswith(error)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "size"),
    [("way.csv", MAX_TABLE_SIZE), ("way.yaml", MAX_OBJECT_SIZE), ("a.json", MAX_OBJECT_SIZE)],
)
def test_files_that_are_too_large(tmp_path: Path, name: str, size: int) -> None:
    path = write(tmp_path / name, "{" + " " * 5000)
    os.truncate(path, size + 1)
    with pytest.raises(TrajectoryError, match="larger than"):
        read_trajectories(path)


@pytest.mark.parametrize(
    ("name", "reader"), [("way.yaml", trajectory_documents), ("a.json", trajectory_reader)]
)
def test_files_of_too_many_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, reader: ModuleType
) -> None:
    monkeypatch.setattr(reader, "MAX_VALUES", 1000)
    shorter = '{"points": [' + "[]," * 300 + "[]]}"
    with pytest.raises(TrajectoryError, match="no trajectory"):
        read_trajectories(write(tmp_path / name, shorter))
    path = write(tmp_path / name, '{"points": [' + "[]," * 1000 + "[]]}")
    with pytest.raises(TrajectoryError, match=f"more than {MAX_VALUES} values"):
        read_trajectories(path)


def test_a_long_object_is_read(tmp_path: Path) -> None:
    row = "[" + ",".join(["1.5"] * 6) + "]"
    count = MAX_VALUES // 7 - 10
    titles = ",".join(f'"J{axis}"' for axis in range(1, 7))
    text = f'{{"format":"{EXTRACT_FORMAT}","columns":[{titles}],"rows":[' + ",".join([row] * count) + "]}"
    (trajectory,) = read_trajectories(write(tmp_path / "a.json", text))
    assert len(trajectory.points) == count


def test_what_cannot_be_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, error in (
        (tmp_path / "nothing.csv", "cannot be read: no such file or directory"),
        (tmp_path / "pipe", "this is not a regular file"),
        (Path("/dev/zero"), "this is not a regular file"),
        (Path("a\0b"), "this is not a file name"),
        (Path("x" * 5000), "cannot be read: file name too long"),
    ):
        with pytest.raises(TrajectoryError) as caught:
            read_trajectories(path)
        assert str(caught.value) == error


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("any")


SAMPLES = [path.read_bytes()[:3000] for path in sorted(CAPTURES.iterdir())]


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    data = bytearray(draw(st.sampled_from(SAMPLES)))
    for _ in range(draw(st.integers(0, 6))):
        at = draw(st.integers(0, len(data)))
        data[at : at + draw(st.integers(0, 8))] = draw(st.binary(max_size=8))
    return bytes(data)


@given(st.binary(max_size=300) | damaged(), st.sampled_from(["a.csv", "a.json", "a.yaml", "a"]))
def test_any_bytes_give_trajectories_or_one_error(place: Path, data: bytes, name: str) -> None:
    with suppress(TrajectoryError):
        assert all(len(each) for each in read_trajectories(write(place / name, data)))
