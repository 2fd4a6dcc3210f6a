"""Folders of projects: searched for logs, and told what to export where there are none."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.player import trajectory_reader
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from tests.cli.run import CAPTURES

LOG = (CAPTURES / "control-log.csv").read_bytes()


def make(folder: Path, **files: bytes) -> Path:
    for name, data in files.items():
        path = folder / name.replace("__", "/").replace("_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder


@pytest.mark.parametrize("name", ["", "line1.wpj"])
def test_logs_anywhere_in_a_project_are_found(tmp_path: Path, name: str) -> None:
    make(tmp_path, line1_wpj=b"?", Log__ctrl_csv=LOG, a_pac=b"PROGRAM", Log__notes_txt=b"1 2 3 4 5 6\n" * 9)
    (trajectory,) = read_trajectories(tmp_path / name)
    assert str(trajectory.source.part) == "Log/ctrl.csv"
    assert len(trajectory) == 251


def test_several_files_are_several_trajectories(tmp_path: Path) -> None:
    make(tmp_path, a_csv=LOG, b_csv=b"J1,J2\n1,2\n", c_pcap=(CAPTURES / "exchanges.pcap").read_bytes())
    found = read_trajectories(tmp_path)
    assert [str(each.source.part) for each in found] == ["a.csv", "b.csv"]


def test_no_more_are_read_than_one_chooses_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory_reader, "MAX_TRAJECTORIES", 2)
    make(tmp_path, a_csv=LOG, b_csv=LOG, c_csv=LOG)
    assert len(read_trajectories(tmp_path)) == 2


def test_what_was_seen_is_told(tmp_path: Path) -> None:
    make(tmp_path, line1_wpj=b"?", a_pac=b"", b_pac=b"", log_dat=b"\0", way_csv=b"a,b\n1,2\n")
    with pytest.raises(TrajectoryError) as caught:
        read_trajectories(tmp_path / "line1.wpj")
    assert str(caught.value) == (
        "this WINCAPS III project holds no control log that can be read, only 5 files "
        "(2 .pac, 1 .wpj, 1 .dat, 1 .csv): get the control log in WINCAPS III, export it as CSV, "
        "and give that file. Not read: way.csv: line 1: no columns for J1 and following, or X to Rz "
        "among these: a, b"
    )


def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="this folder is empty"):
        read_trajectories(tmp_path)


def test_no_more_files_are_looked_at_than_it_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory_reader, "MAX_FILES", 2)
    make(tmp_path, a_dat=b"", b_dat=b"", c_csv=LOG)
    with pytest.raises(TrajectoryError, match="only 2 files"):
        read_trajectories(tmp_path)


def test_links_lead_nowhere(tmp_path: Path) -> None:
    make(tmp_path, a_csv=LOG)
    (tmp_path / "round").symlink_to(tmp_path)
    assert len(read_trajectories(tmp_path)) == 1


def test_a_project_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="cannot be read: no such file"):
        read_trajectories(tmp_path / "line1.wpj")
