"""Which columns make a trajectory."""

from __future__ import annotations

import pytest

from bcapscope.player.column_layout import ReadOptions, layout_of_numbers, layout_of_titles, parse_columns
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.player.ways import texts

JOINTS = [f"J{axis}" for axis in range(1, 7)]
POSITION = ["X", "Y", "Z", "Rx", "Ry", "Rz", "Fig"]
LOG = [
    f"[J{axis} - {what}]" for axis in range(1, 9) for what in ("指令値", "エンコーダ値", "電流値", "負荷率")
]
LOG += [
    "[ユーザデータ]",
    "[プログラム管理番号]",
    "[ファイル名]",
    "[行番号]",
    "[コントローラ起動時からのカウンタ]",
]
LOG += ["[ツール番号]", "[ワーク番号]"]
LONG_LOG = [
    "[No.]",
    *LOG,
    *(f"[{axis.upper()} - {what}]" for what in ("指令値", "エンコーダ値") for axis in POSITION),
]


def places(titles: list[str], wishes: ReadOptions | None = None) -> tuple[PoseType, list[int]]:
    layout = layout_of_titles(titles, wishes or ReadOptions())
    assert layout is not None
    return layout.kind, [column.position for column in layout.columns]


@pytest.mark.parametrize(
    ("titles", "kind", "expected"),
    [
        (JOINTS, PoseType.J, [1, 2, 3, 4, 5, 6]),
        (["time", *reversed(JOINTS)], PoseType.J, [7, 6, 5, 4, 3, 2]),
        (POSITION, PoseType.P, [1, 2, 3, 4, 5, 6, 7]),
        (POSITION[:6], PoseType.P, [1, 2, 3, 4, 5, 6]),
        (["X", "Y", "Z", "Ox", "Oy", "Oz", "Ax", "Ay", "Az"], PoseType.T, list(range(1, 10))),
        (["J1 actual", "J1 target"], PoseType.J, [2]),
        (["J1 actual", "J1"], PoseType.J, [2]),
        (LOG, PoseType.J, list(range(1, 33, 4))),
        (LONG_LOG, PoseType.J, list(range(2, 34, 4))),
    ],
)
def test_columns_are_found_by_title(titles: list[str], kind: PoseType, expected: list[int]) -> None:
    assert places(titles) == (kind, expected)


def test_the_commanded_position_of_a_long_log() -> None:
    assert places(LONG_LOG, ReadOptions(PoseType.P)) == (PoseType.P, list(range(41, 48)))


def test_what_the_counter_is() -> None:
    layout = layout_of_titles(LONG_LOG, ReadOptions())
    assert layout is not None
    assert layout.counter is not None
    assert (layout.counter.axis, layout.counter.position) == ("counter", 38)
    layout = layout_of_titles(["[No.]", *JOINTS], ReadOptions())
    assert layout is not None
    assert layout.counter is not None
    assert layout.counter.axis == "number"


def test_other_types_in_the_file_are_told() -> None:
    layout = layout_of_titles([*JOINTS, *POSITION], ReadOptions())
    assert layout is not None
    assert texts(layout.notes) == ("type J was chosen; the file also has type P",)


def test_values_that_may_be_measured_are_told() -> None:
    layout = layout_of_titles([*LOG, *POSITION], ReadOptions(PoseType.P))
    assert layout is not None
    assert texts(layout.notes)[0] == "the file does not mark these values as commanded; they may be measured"
    layout = layout_of_titles(["J1 actual", "J2 actual"], ReadOptions())
    assert layout is not None
    assert texts(layout.notes) == ("these are measured values, because the file has no commanded ones",)


@pytest.mark.parametrize(
    "titles", [["a", "b"], ["J2", "J3"], ["J1", "J3"], ["X", "Y", "Z"], ["J1 - 電流値"], []]
)
def test_no_pose_is_whole(titles: list[str]) -> None:
    assert layout_of_titles(titles, ReadOptions()) is None


@pytest.mark.parametrize(
    ("titles", "wishes", "unit", "factor"),
    [
        (["J1"], ReadOptions(), "deg", 1.0),
        (["J1"], ReadOptions(angle="rad"), "rad", 57.29577951308232),
        (["J1_rad"], ReadOptions(), "rad", 57.29577951308232),
        (["J1_deg"], ReadOptions(angle="rad"), "deg", 1.0),
        (["J1_m"], ReadOptions(), "m", 1000.0),
        (["X", "Y", "Z", "Rx", "Ry", "Rz"], ReadOptions(length="m"), "m", 1000.0),
    ],
)
def test_units(titles: list[str], wishes: ReadOptions, unit: str, factor: float) -> None:
    layout = layout_of_titles(titles, wishes)
    assert layout is not None
    assert (layout.columns[0].unit, layout.columns[0].factor) == (unit, factor)


def test_an_axis_that_is_there_twice_is_told() -> None:
    layout = layout_of_titles(["J1", "J1 (command)", "J1", "J2"], ReadOptions())
    assert layout is not None
    assert texts(layout.notes) == ()
    layout = layout_of_titles(["J2", "J1", "a", "J1", "J2", "J1"], ReadOptions())
    assert layout is not None
    assert texts(layout.notes) == (
        "J1 is in columns 2, 4, 6; the first of them is used",
        "J2 is in columns 1, 5; the first of them is used",
    )


@pytest.mark.parametrize("count", [6, 7, 8])
def test_bare_numbers_are_joints(count: int) -> None:
    layout = layout_of_numbers([[float(axis) for axis in range(count)]] * 3, ReadOptions())
    assert [column.axis for column in layout.columns] == [f"J{axis}" for axis in range(1, count + 1)]


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ([[1.0] * 5], "5 numbers per line and no titles, where 6 to 8"),
        ([[1.0] * 39], "39 numbers per line"),
        ([[300.0, 0, 200, 0, 90, 0, 5.0]] * 3, "which may be X to Fig"),
        ([[k * 0.008, 1, 2, 3, 4, 5, 6.5] for k in range(4)], "the first of which may be a time"),
        ([[k * 0.008, 1, 2, 3, 4, 5] for k in range(4)], "the first of which may be a time"),
        ([[12.5 + k * 0.008, 1, 2, 3, 4, 5, 6.5] for k in range(4)], "the first of which may be a time"),
        ([[k + 1.0, 1, 2, 3, 4, 5] for k in range(4)], "or a record number"),
    ],
)
def test_bare_numbers_that_may_be_something_else(rows: list[list[float]], reason: str) -> None:
    with pytest.raises(TrajectoryError, match=reason):
        layout_of_numbers(rows, ReadOptions())


def test_six_bare_numbers_may_begin_on_the_way() -> None:
    rows = [[12.5 + number, 1, 2, 3, 4, 5] for number in range(4)]
    assert layout_of_numbers(rows, ReadOptions()).kind is PoseType.J


def test_bare_numbers_of_a_type_that_was_told() -> None:
    assert layout_of_numbers([[300.0, 0, 200, 0, 90, 0, 5]] * 3, ReadOptions(PoseType.P)).kind is PoseType.P
    assert len(layout_of_numbers([[1.0] * 10], ReadOptions(PoseType.T)).columns) == 10
    with pytest.raises(TrajectoryError, match="where 7 numbers per line are expected"):
        layout_of_numbers([[1.0] * 8], ReadOptions(PoseType.P))


def test_columns_as_told() -> None:
    told = parse_columns(" time=1, J1..J3=4..6 ,j4=2")
    assert told == {"time": 1, "J1": 4, "J2": 5, "J3": 6, "J4": 2}
    layout = layout_of_numbers([[0.0] * 6], ReadOptions(columns=told))
    assert [column.position for column in layout.columns] == [4, 5, 6, 2]
    assert layout.time is not None
    assert layout.time.position == 1
    titled = layout_of_titles(["a", "b", "c (rad)"], ReadOptions(columns={"J1": 3}))
    assert titled is not None
    assert (titled.columns[0].name, titled.columns[0].position) == ("c (rad)", 3)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not a list of columns"),
        ("J1", "is not a list of columns"),
        ("J1=x", "is not a list of columns"),
        ("J1=0", "columns are counted from 1"),
        ("J9=1", "Names are"),
        ("J3..J1=1..3", "J1 does not come after J3"),
        ("J1..J3=1..2", "3 names for 2 columns"),
        ("J1=3..1", "columns are counted from 1"),
        ("J1=1,J1=2", "given twice"),
        ("J1=1,", "is not a list of columns"),
        ("J1=99999", "is not a list of columns"),
    ],
)
def test_columns_that_make_no_sense(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_columns(text)


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        ("J1=7", "there are 6 columns, so none for J1=7"),
        ("time=1", "not a complete pose"),
        ("J2=1", "not a complete pose"),
        ("J1=1,J3=2", "J3 do not belong to J1 to J1"),
        ("J1=1,X=2", "X do not belong to J1 to J1"),
    ],
)
def test_columns_that_do_not_fit(told: str, reason: str) -> None:
    with pytest.raises(TrajectoryError, match=reason):
        layout_of_titles(["a"] * 6, ReadOptions(columns=parse_columns(told)))
