"""Steps and what stands out among them, against a loop over plain numbers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bcapscope.analysis.slave.column_templates import PoseColumns
from bcapscope.analysis.slave.motion_model import (
    JUMP_TIMES,
    LARGEST_STEP,
    SMALLEST_JUMP,
    JumpKind,
    MotionFacts,
    MotionModel,
)
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, Axis
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW
from tests.analysis.slave.set_points import set_points

JOINTS = AXES[PoseType.J][:2]
NAN = float("nan")


def followed(
    points: Sequence[Sequence[float]],
    returned: Sequence[Sequence[float] | None] = (),
    axes: tuple[Axis, ...] = JOINTS,
    pose_type: PoseType = PoseType.J,
    *,
    cuts: Sequence[int] = (),
    unreadable: Sequence[int] = (),
    refused: Sequence[int] = (),
) -> MotionFacts:
    """Follow points whose frames are 1, 3, 5 and so on, in pieces that end at `cuts`.

    The controller has no room for the points at `refused`.
    """
    count, width = len(points), len(axes)
    poses = np.array(points, np.float64).reshape(count, width)
    model = MotionModel(axes, pose_type, guessed=False)
    for part in np.split(np.arange(count), sorted(cuts)):
        if not len(part):
            continue
        commanded, back = PoseColumns(len(part), width), PoseColumns(len(part), width)
        for row, at in enumerate(part.tolist()):
            commanded.poses[row], commanded.has_pose[row] = poses[at], at not in unreadable
            pose = returned[at] if at < len(returned) else None
            if pose is not None:
                back.poses[row], back.has_pose[row] = pose, True
        frames = part * 2 + 1
        codes = np.where(np.isin(part, refused), E_SLAVE_OVERFLOW, 0)
        model.add(set_points(frames * 1_000_000, frames=frames, codes=codes), commanded, back)
    return model.facts(8.0)


VALUES = st.sampled_from([0.0, 0.01, 0.5, 1.0, 3.0, 90.0, -120.0])
POINTS = st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=40)


@given(POINTS, st.lists(st.integers(0, 40), max_size=6))
def test_steps_by_a_plain_loop(points: list[tuple[float, float]], cuts: list[int]) -> None:
    motion = followed(points, cuts=cuts)
    for axis, told in enumerate(motion.axes):
        row = [point[axis] for point in points]
        steps = [b - a for a, b in pairwise(row)]
        changes = [abs(b - a) for a, b in pairwise(steps)]
        assert (told.least, told.most) == (min(row), max(row))
        assert (told.step and told.step.count) == (len(steps) or None)
        if steps and told.largest_step and told.largest_velocity:
            sizes = [abs(step) for step in steps]
            assert told.largest_step == (max(sizes), 2 * (sizes.index(max(sizes)) + 1) + 1)
            assert told.largest_velocity.value == pytest.approx(max(sizes) * 125)
        if changes and told.largest_acceleration:
            assert told.largest_acceleration.frame == 2 * (changes.index(max(changes)) + 2) + 1
            assert told.largest_acceleration.value == pytest.approx(max(changes) * 125 * 125)


def far(steps: Sequence[NDArray[np.float64]], row: int, before: int, behind: int) -> NDArray[np.bool_]:
    """Tell on which axes a step is far larger than two others."""
    size, beside = abs(steps[row]), np.maximum(abs(steps[before]), abs(steps[behind]))
    found: NDArray[np.bool_] = (size > SMALLEST_JUMP) & (size > JUMP_TIMES * beside)
    return found


@given(POINTS, st.lists(st.integers(0, 40), max_size=6))
def test_stops_and_jumps_by_a_plain_loop(points: list[tuple[float, float]], cuts: list[int]) -> None:
    motion = followed(points, cuts=cuts)
    steps = [np.subtract(b, a) for a, b in pairwise(points)]
    repeated = [row + 1 for row, step in enumerate(steps) if not step.any()]
    inner = range(1, len(steps) - 1)
    stutters = [
        row for row in inner if not steps[row].any() and steps[row - 1].any() and steps[row + 1].any()
    ]
    jumps = {row for row, step in enumerate(steps) if max(abs(step)) > LARGEST_STEP}
    jumps |= {row for row in inner if any(far(steps, row, row - 1, row + 1))}
    jumps |= {
        row
        for row in range(1, len(steps) - 2)
        if jumps.isdisjoint((row, row + 1))
        and any(
            far(steps, row, row - 1, row + 2)
            & far(steps, row + 1, row - 1, row + 2)
            & (np.signbit(steps[row]) != np.signbit(steps[row + 1]))
        )
    }
    assert (motion.repeated, motion.stutters, motion.jumps) == (len(repeated), len(stutters), len(jumps))
    assert motion.stutter_frames == tuple(2 * (row + 1) + 1 for row in stutters)
    assert tuple(jump.frame for jump in motion.jump_list) == tuple(2 * (row + 1) + 1 for row in sorted(jumps))


@settings(deadline=None)
@given(POINTS, st.lists(st.integers(0, 40), max_size=6))
def test_cutting_changes_nothing(points: list[tuple[float, float]], cuts: list[int]) -> None:
    back = [(a + 0.5, b) for a, b in points]
    assert followed(points, back, cuts=cuts) == followed(points, back)


def test_a_jump_tells_its_axis_and_size() -> None:
    motion = followed([(0, 0), (0.1, 0), (0.2, -5), (0.3, -5), (0.4, -5)])
    assert motion.jump_list == ((5, 5_000_000, "J2", -5.0, JumpKind.ISOLATED),)


def test_one_set_point_off_the_path_is_one_jump() -> None:
    motion = followed([(0, 0), (0.1, 0), (9, 0), (0.3, 0), (0.4, 0)])
    assert motion.jump_list == ((5, 5_000_000, "J1", 8.9, JumpKind.OUTLIER),)


def test_a_step_that_no_axis_follows_needs_no_others_beside_it() -> None:
    assert followed([(0, 0), (0, 1e200)]).jump_list == ((3, 3_000_000, "J2", 1e200, JumpKind.IMPLAUSIBLE),)
    assert followed([(0, 0), (0, LARGEST_STEP)]).jumps == 0


def test_angles_that_turn_take_the_short_way() -> None:
    axes = AXES[PoseType.P]
    points = [(0, 0, 0, 0, 0, rz, 5) for rz in (178.0, 179.5, -179.0, -177.5)]
    rz = followed(points, axes=axes, pose_type=PoseType.P).axes[5]
    assert rz.largest_step == (1.5, 3)
    joint = followed([(178.0, 0), (-178.0, 0)]).axes[0]
    assert joint.largest_step == (356.0, 3)


def test_figures_that_change_are_counted() -> None:
    axes = AXES[PoseType.P]
    points = [(0, 0, 0, 0, 0, 0, fig) for fig in (5, 5, 1, 1, 5)]
    motion = followed(points, axes=axes, pose_type=PoseType.P)
    assert (motion.figure_changes, motion.jumps) == (2, 0)


def test_commanded_against_returned() -> None:
    motion = followed([(0, 0), (1, 0), (2, 0)], [(0, 0), None, (1.5, 0.25)])
    first, second = motion.axes
    assert motion.returned == 2
    assert first.largest_difference == (0.5, 5)
    assert second.largest_difference == (0.25, 5)
    assert first.difference is not None
    assert (first.difference.count, first.difference.most) == (2, 0.5)


def test_what_is_no_number_is_counted_and_left_out() -> None:
    motion = followed([(0, 0), (NAN, 0), (1, float("inf")), (2, 0)], unreadable=[3])
    assert (motion.read, motion.unread, motion.not_finite) == (1, 1, 2)
    assert motion.not_finite_frames == (3, 5)
    assert motion.axes[0].step is None


def test_points_refused_by_a_full_buffer_are_neither_read_nor_unreadable() -> None:
    points = [(0, 0), (1, 0), (1, 0), (NAN, 0), (5, 0), (2, 0)]
    motion = followed(points, unreadable=[4], refused=[1, 3, 4])
    assert (motion.read, motion.unread, motion.not_finite, motion.repeated) == (3, 0, 0, 0)
    assert followed(points[:5], unreadable=range(5), refused=[1, 3]).unread == 3


def test_nothing_that_can_be_read() -> None:
    motion = followed([(0, 0)] * 5, unreadable=range(5))
    assert (motion.read, motion.unread, motion.axes, motion.lag_cycles) == (0, 5, (), None)
    assert followed([()] * 3, axes=()).axes == ()


def test_lists_are_bounded_and_counts_are_not() -> None:
    motion = followed([((n // 2) % 2 * 5.0, n % 2 * 1e-3) for n in range(1000)])
    assert motion.jumps > len(motion.jump_list) == MAX_LISTED
    odd = followed([(NAN, 0.0)] * 500, cuts=[100, 200])
    assert (odd.not_finite, len(odd.not_finite_frames)) == (500, MAX_LISTED)


@given(st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=30))
def test_no_numbers_break_it(points: list[tuple[float, float]]) -> None:
    with np.errstate(all="ignore"):
        motion = followed(points, points)
    assert motion.read + motion.not_finite == len(points)
