"""Poses: axes, and the type behind a row of numbers."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, Pose, build_pose, guess_pose_type, pose_numbers

P, J, T = PoseType.P, PoseType.J, PoseType.T
MARK = float(0x400000 | 0x3F)  # as the ROS driver appends it for a robot of six axes


def test_axes() -> None:
    assert [f"{axis.name}[{axis.unit}]" for axis in AXES[P]] == [
        *("X[mm]", "Y[mm]", "Z[mm]"),
        *("Rx[deg]", "Ry[deg]", "Rz[deg]"),
        "Fig[]",
    ]
    assert [axis.name for axis in AXES[J]] == [f"J{number}" for number in range(1, 9)]
    assert {axis.unit for axis in AXES[J]} == {"deg"}
    assert [axis.name for axis in AXES[T]] == ["X", "Y", "Z", "Ox", "Oy", "Oz", "Ax", "Ay", "Az", "Fig"]


@pytest.mark.parametrize(
    ("count", "mark", "guess"),
    [
        (6, False, J),  # the Tester of 2009 sends six joints
        (7, False, P),
        (8, False, J),
        (10, False, T),
        (8, True, P),
        (9, True, J),
        (11, True, T),
        (9, False, None),
        (0, False, None),
        (12, False, None),
    ],
)
def test_guess(count: int, mark: bool, guess: PoseType | None) -> None:
    values = tuple(float(number) for number in range(count))
    assert guess_pose_type((*values[:-1], MARK) if mark else values) is guess


@pytest.mark.parametrize("pose_type", list(PoseType))
def test_the_drivers_mark_is_no_axis(pose_type: PoseType) -> None:
    size = len(AXES[pose_type])
    pose, problems = build_pose((1.0,) * size + (MARK,), pose_type)
    assert pose == Pose(pose_type, (1.0,) * size, (MARK,))
    assert pose.used_axes == 0x3F
    assert problems == ()
    assert build_pose((1.0,) * size + (MARK,), None)[0] == pose._replace(guessed=True)


@pytest.mark.parametrize(
    ("number", "used"),
    [
        (4_194_304.0, 0),
        (4_194_559.0, 0xFF),
        (4_194_303.0, None),
        (4_194_560.0, None),
        (4_194_304.5, None),
    ],
)
def test_the_driver_marks_up_to_eight_axes(number: float, used: int | None) -> None:
    assert build_pose((1.0,) * 8 + (number,), PoseType.J)[0].used_axes == used


@pytest.mark.parametrize(
    ("pose_type", "count", "problem"),
    [
        (P, 6, None),
        (P, 7, None),
        (J, 5, "5 numbers for a pose of type J, which has 8"),
        (T, 9, "9 numbers for a pose of type T, which has 10"),
        (P, 5, "5 numbers for a pose of type P, which has 7"),
        (P, 8, "8 numbers for a pose of type P, which has 7"),
        (J, 6, None),
        (J, 8, None),
        (J, 10, "10 numbers for a pose of type J, which has 8"),
        (T, 10, None),
        (T, 8, "8 numbers for a pose of type T, which has 10"),
        (None, 9, "9 numbers are no pose of type P, J or T"),
    ],
)
def test_counts_that_fit_and_that_do_not(pose_type: PoseType | None, count: int, problem: str | None) -> None:
    pose, problems = build_pose((0.5,) * count, pose_type)
    assert list(map(str, problems)) == ([problem] if problem else [])
    assert len(pose.values) + len(pose.extra) == count
    assert len(pose.axes) == (len(pose.values) if pose.type else 0)


@pytest.mark.parametrize(
    ("variant", "row"),
    [
        (Variant.array(VT.R4, (1.0, 2.0)), (1.0, 2.0)),
        (Variant.array(VT.I4, (1, 2)), (1, 2)),
        (Variant.array(VT.VARIANT, (Variant(VT.I4, 1), Variant(VT.R8, 2.5))), (1, 2.5)),
        (Variant.array(VT.VARIANT, (Variant(VT.I4, 1), Variant(VT.BOOL, True))), None),
        (Variant.array(VT.VARIANT, (Variant.array(VT.R8, (1.0,)),)), None),
        (Variant.array(VT.UI1, b"12"), None),
        (Variant.array(VT.BSTR, ("1",)), None),
        (Variant(VT.R8, 1.0), None),
        (EMPTY, None),
    ],
)
def test_rows_of_numbers(variant: Variant, row: tuple[float, ...] | None) -> None:
    assert pose_numbers(variant) == row
