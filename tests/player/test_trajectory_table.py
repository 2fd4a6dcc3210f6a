"""Tables: what they are read as, and the one sentence on those that are none."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.messages import Message
from bcapscope.player.column_layout import ReadOptions, parse_columns
from bcapscope.player.trajectory import Trajectory, TrajectoryError, TrajectorySource
from bcapscope.player.trajectory_table import read_table
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.player.test_column_layout import LOG, LONG_LOG
from tests.player.ways import texts

UTF8 = TrajectorySource("way.csv", Message.from_table("text", "UTF-8"))


def read(text: str, wishes: ReadOptions | None = None) -> tuple[Trajectory, ...]:
    return read_table(text.splitlines(keepends=True), UTF8, wishes or ReadOptions())


def log(counters: Sequence[int], titles: Sequence[str] = LOG) -> str:
    """Write a log in which a cell is the number of its column and a hundredth of that of its record."""
    rows = [
        [counter if "カウンタ" in title else f"{place + row / 100:g}" for place, title in enumerate(titles)]
        for row, counter in enumerate(counters)
    ]
    return "\n".join(",".join(map(str, row)) for row in [titles, *rows])


@pytest.mark.parametrize(
    "text",
    [
        "J1,J2\n1,2\n3,4\n",
        "J1,J2\r\n1,2\r\n3,4\r\n",
        "J1\tJ2\n1\t2\n3\t4",
        "J1;J2\n1,0;2,0\n3,0;4,0\n",
        "J1 J2\n1 2\n3 4\n",
        "  J1   J2\n\n 1.0  2e0\n\n +3 4.\n",
        "# a comment\nJ1,J2\n#another\n1,2\n3,4\n",
        '"J1","J2"\n"1","2"\n"3","4"\n',
        "J1,J2,\n1,2,\n3,4,\n",
        "J1,J2\n1,2,\n3,4,,\n",
        "file: way.src\nwritten: today\n\nJ1,J2\n1,2\n3,4\n",
        "J2,junk,J1\n2,x,1\n4,y,3\n",
    ],
)
def test_the_same_numbers_in_many_forms(text: str) -> None:
    (trajectory,) = read(text)
    assert trajectory.points.tolist() == [[1, 2], [3, 4]]
    assert (trajectory.kind, trajectory.period, trajectory.times) == (PoseType.J, None, None)


def test_numbers_alone() -> None:
    (trajectory,) = read("1 2 3 4 5 6\n7 8 9 10 11 12\n")
    assert trajectory.points.shape == (2, 6)
    assert texts(trajectory.source.notes) == ("no titles: 6 numbers per line are read as J1 to J6",)


def test_columns_are_told() -> None:
    (trajectory,) = read("time_ms,J1_rad,x\n0,1,a\n10,2,b\n", None)
    assert [
        (column.axis, column.position, column.name, column.unit) for column in trajectory.source.columns
    ] == [
        ("J1", 2, "J1_rad", "rad"),
        ("time", 1, "time_ms", "ms"),
    ]
    assert trajectory.points[0, 0] == pytest.approx(math.degrees(1))
    assert trajectory.period == 0.01


def test_times_that_are_uneven_are_kept() -> None:
    (trajectory,) = read("t,J1\n1,1\n1.5,2\n3,3\n")
    assert trajectory.period is None
    assert trajectory.times is not None
    assert trajectory.times.tolist() == [0, 0.5, 2]


@pytest.mark.parametrize("titles", [LOG, LONG_LOG])
def test_a_log_gives_commanded_values(titles: list[str]) -> None:
    (trajectory,) = read(log(range(1000, 1040, 8), titles))
    first = titles.index("[J1 - 指令値]")
    assert trajectory.points[0].tolist() == list(range(first, first + 32, 4))
    assert trajectory.period == 0.008
    assert str(trajectory.source.file_format) == "control log, UTF-8"
    assert "the counter grows by 8, which is read as ms" in texts(trajectory.source.notes)


def test_the_commanded_position_of_a_long_log() -> None:
    (trajectory,) = read(log(range(5), LONG_LOG), ReadOptions(PoseType.P))
    assert trajectory.kind is PoseType.P
    assert trajectory.points[0].tolist() == list(range(40, 47))
    assert trajectory.period is None
    assert "the counter counts records, not time" in texts(trajectory.source.notes)


def test_a_counter_in_microseconds() -> None:
    (trajectory,) = read(log(range(0, 80_000, 8000)))
    assert trajectory.period == 0.008


def test_a_log_with_records_missing_is_taken_apart() -> None:
    parts = read(log([8, 16, 24, 80, 88]))
    assert [(len(part), str(part.source.part)) for part in parts] == [
        (3, "records 1 to 3"),
        (2, "records 4 to 5"),
    ]
    assert all("records are missing" in texts(part.source.notes)[-2] for part in parts)
    assert parts[1].points[0, 0] == 0.03


def test_axes_that_are_empty_are_left_out() -> None:
    (trajectory,) = read("J1,J2,J3\n1,2,\n3,4,\n")
    assert trajectory.points.shape == (2, 2)
    assert texts(trajectory.source.notes) == ("J3 and all axes after it are empty",)


def test_nan_is_left_to_the_pre_flight() -> None:
    (trajectory,) = read("J1,J2\n1,nan\n3,-inf\n")
    assert str(trajectory.points[:, 1].tolist()) == "[nan, -inf]"


def test_columns_that_the_user_told() -> None:
    (trajectory,) = read("0 9 1\n0.008 9 2\n", ReadOptions(columns=parse_columns("time=1,J1=3")))
    assert trajectory.points.tolist() == [[1], [2]]
    assert trajectory.period == 0.008


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "the file contains no lines"),
        ("\n\n# only a comment\n", "the file contains no lines"),
        ("J1,J2\n", "there are titles, but no numbers under them"),
        ("a,b\n1,2\n", "line 1: no columns for J1 and following, or X to Rz among these: a, b"),
        ("J1,J2\n1,2\n3\n", "line 3: 1 column, but the lines before have 2"),
        ("J1,J2\n1,2\n3,4,5\n", "line 3: 3 columns, but the lines before have 2"),
        ("J1,J2\n1,2\n\n3,x\n", "line 4, column 2: 'x' is not a number for J2"),
        ("J1,J2\n1,2\n3,1_0\n", "line 3, column 2: '1_0' is not a number for J2"),
        ("J1,J2\n1,2\n3,\n", "line 3, column 2: J2 is empty here, but not in an earlier line"),
        ("J1,J2\n1,\n3,4\n", "line 3, column 2: J2 is not empty here, but in an earlier line"),
        ("J1,J2,J3\n1,,3\n1,,3\n", "column 2: J2 is empty throughout"),
        ("J1,J2\n,2\n,2\n", "column 1: J1 is empty throughout"),
        (
            "1 2 3\n4 5 6\n",
            "line 1: 3 numbers per line and no titles, where 6 to 8 numbers per line are expected",
        ),
        ("1,2,3,4,5,6\n1,2,3,4,5\n", "line 2: 5 columns, but the lines before have 6"),
        (
            'J1,J2\n1,"2\n' + "3,4\n" * 50_000,
            "line 32770: this is not a table: field larger than field limit (131072)",
        ),
        ('"a\nb",c\n', "line 2: no columns for J1 and following, or X to Rz among these: a b, c"),
        ("\0,\0\n", "line 1: no columns for J1 and following, or X to Rz among these: \0, \0"),
    ],
)
def test_what_is_no_table(text: str, error: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        read(text)
    assert str(caught.value).startswith(error)
    assert "\n" not in str(caught.value)


CELL = st.one_of(
    st.floats().map(str),
    st.integers(-400, 400).map(str),
    st.sampled_from(["", "nan", "J1", "[J1 - 指令値]", "time_s", '"', "x", "1,5", "９", "1e999"]),
)


@given(st.lists(st.lists(CELL, max_size=9), max_size=40), st.sampled_from([",", ";", "\t", " "]))
def test_any_cells_give_trajectories_or_one_error(rows: list[list[str]], mark: str) -> None:
    try:
        trajectories = read("\n".join(mark.join(row) for row in rows))
    except TrajectoryError:
        return
    assert all(len(each) for each in trajectories)


@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6), min_size=1, max_size=30))
def test_numbers_come_back_as_they_were(rows: list[list[float]]) -> None:
    text = "J1,J2,J3,J4,J5,J6\n" + "\n".join(",".join(map(repr, row)) for row in rows)
    assert read(text)[0].points.tolist() == rows
