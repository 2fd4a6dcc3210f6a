"""The controller's log as CSV, which the player reads again."""

from __future__ import annotations

import io
from pathlib import Path

from bcapscope.player.control_log import LOG_COLUMN_TITLES, write_control_log
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.codec.variant import Value


def test_a_log_is_written_so_that_it_can_be_played(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    records: list[Value] = [
        (*(float(number + column) for column in range(32)), 0, 0, 'a "b", c', 0, 8 * number, 0, 0)
        for number in range(5)
    ]
    with path.open("wb") as file:
        write_control_log(file, records)
    (trajectory,) = read_trajectories(path)
    assert trajectory.points.tolist() == [
        [float(number + column) for column in range(0, 32, 4)] for number in range(5)
    ]
    assert trajectory.period == 0.008


def test_no_text_of_the_controller_is_computed_by_a_spreadsheet() -> None:
    file = io.BytesIO()
    write_control_log(file, [(-1.5, "=1+1", " @SUM(1)", "-", "pick.pcs")])
    assert file.getvalue().decode().splitlines()[1] == "-1.5,'=1+1,' @SUM(1),'-,pick.pcs"


def test_a_record_that_is_none_is_written_as_it_is() -> None:
    file = io.BytesIO()
    write_control_log(file, ["odd", None, "\ud800"])
    assert file.getvalue().decode().splitlines()[1:] == ["odd", '""', "\\ud800"]
    assert len(LOG_COLUMN_TITLES) == 39
