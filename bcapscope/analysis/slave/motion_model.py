"""Analyse the motion that set points command, and the poses that the controller returns.

A step is the change of an axis's position from one set point to the next. A controller takes one set point
per period, no matter when within the period it arrived. Therefore `MotionModel` computes velocity and
acceleration as if the client sent exactly one set point per period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.axis_lag import AxisLag
from bcapscope.analysis.slave.column_templates import PoseColumns
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import Bools, Floats, Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import Axis
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW

JUMP_TIMES = 5.0
"""A step is an isolated jump if it is more than this many times as large as each neighbouring step. No robot
can change its speed this much within 8 ms.
"""

SMALLEST_JUMP = 0.2
"""Smallest step that can be a jump, in degrees or mm: 25 per second at a cycle time of 8 ms. Shorter steps
are rounding errors or noise.
"""

LARGEST_STEP = 180.0
"""Largest step that can be normal motion, in degrees or mm: 22,500 per second at a cycle time of 8 ms. No
source gives a speed limit for every axis, but this speed is far above any limit.
"""

_FIGURE = "Fig"
_TURN = 360.0


class Peak(NamedTuple):
    """The largest value of a figure, such as the velocity, and the request frame that caused this value."""

    value: float
    frame: int


@dataclass(frozen=True, slots=True)
class AxisMotion:
    """Commanded motion of one axis in a slave-mode session.

    Velocity and acceleration are computed as if the client sent one set point every `grid_ms`.

    Attributes:
        name: Name of the axis, such as J1, X or Rx.
        unit: Unit of the position: "deg" or "mm"; "" for a value without a unit, such as Fig.
        least: Smallest commanded position of the axis.
        most: Largest commanded position of the axis.
        step: Absolute distance between successive set points; None for fewer than two set points.
        velocity: Absolute velocity in units per second; None for fewer than two set points.
        acceleration: Absolute acceleration in units per second squared; None for fewer than three set points.
        difference: Absolute difference between the positions in a request and in its reply; None if no reply
            has a pose of the same type.
        lag_cycles: Estimated lag of the returned pose, in set points; None if the axis moves too little.
    """

    name: str
    unit: str
    least: float
    most: float
    step: DistributionSummary | None
    velocity: DistributionSummary | None
    acceleration: DistributionSummary | None
    largest_step: Peak | None
    largest_velocity: Peak | None
    largest_acceleration: Peak | None
    difference: DistributionSummary | None
    largest_difference: Peak | None
    lag_cycles: float | None


class JumpKind(Enum):
    ISOLATED = "isolated"
    """The step is far larger than the step before it and the step after it."""
    OUTLIER = "outlier"
    """A single set point is away from the path of the axis: the axis jumps to this point and back."""
    IMPLAUSIBLE = "implausible"
    """The step is larger than `LARGEST_STEP`."""


class Jump(NamedTuple):
    """A step between two set points that is too large to be intended.

    Attributes:
        frame: Number of the request frame that commands the jump.
        time: Time of this request, ns since 1970.
        axis: Name of the axis with the largest step.
        step: Signed step of `axis`, in degrees or mm.
    """

    frame: int
    time: int
    axis: str
    step: float
    kind: JumpKind


@dataclass(frozen=True, slots=True)
class MotionFacts:
    """Facts about the commanded motion of a slave-mode session, and about the returned poses.

    Set points that the controller refused because of a full buffer are left out, because the client sends
    them again.

    Attributes:
        read: Number of set points with a readable pose.
        unread: Number of set points whose pose is unreadable or of another type.
        not_finite: Number of set points with a NaN or an infinity, which all other figures leave out.
        not_finite_frames: Frame numbers of the first requests with a NaN or an infinity.
        pose_type_guessed: Whether the pose type was inferred from the number of values in a pose.
        returned: Number of replies with a pose of the same type as the commanded pose.
        repeated: Number of set points that are equal to the previous set point.
        stutters: Number of repeated set points in the middle of a motion; each stops the robot for a period.
        stutter_frames: Frame numbers of the first requests that made the robot stutter.
        jumps: Number of jumps of all kinds (see `JumpKind`).
        figure_changes: How often the value Fig (the posture) changes; 0 for joint positions.
        first_distance: First set point minus the robot's position at that time, per axis; () if unknown.
    """

    read: int
    unread: int
    not_finite: int
    not_finite_frames: tuple[int, ...]
    pose_type_guessed: bool
    axes: tuple[AxisMotion, ...]
    returned: int
    repeated: int
    stutters: int
    stutter_frames: tuple[int, ...]
    jumps: int
    jump_list: tuple[Jump, ...]
    figure_changes: int
    lag_cycles: float | None
    first_distance: tuple[float, ...]
    first_distance_known_by: Message | None
    first_distance_frames: tuple[int, ...]


class KnownPosition(NamedTuple):
    pose_type: PoseType
    values: tuple[float, ...]
    known_by: Message
    frames: tuple[int, ...]


class _StartDistance(NamedTuple):
    distance: tuple[float, ...] = ()
    known_by: Message | None = None
    frames: tuple[int, ...] = ()


class _FigureByAxis:
    """The distribution of a figure for each axis, its largest value, and the frame with the largest value."""

    def __init__(self, axes: int) -> None:
        self._histograms = [Histogram() for _ in range(axes)]
        self._largest = np.full(axes, -1.0)
        self._frames = np.zeros(axes, np.int64)

    def add(self, values: Floats, frames: NDArray[np.int64]) -> None:
        if not len(values):
            return
        rows = values.argmax(axis=0)
        found = values[rows, np.arange(values.shape[1])]
        better = found > self._largest
        self._largest[better] = found[better]
        self._frames[better] = frames[rows][better]
        for histogram, column in zip(self._histograms, values.T, strict=True):
            histogram.add(column)

    def distribution(self, axis: int) -> DistributionSummary | None:
        return self._histograms[axis].distribution()

    def peak(self, axis: int, factor: float = 1.0) -> Peak | None:
        value = float(self._largest[axis])
        return Peak(value * factor, int(self._frames[axis])) if value >= 0 else None


class MotionModel:
    def __init__(
        self,
        axes: Sequence[Axis],
        pose_type: PoseType | None,
        guessed: bool,
        position: KnownPosition | None = None,
    ) -> None:
        self._axes = axes
        self._pose_type = pose_type
        self._position = position
        self._start: _StartDistance | None = None
        count = len(axes)
        self._guessed = guessed
        self._figure = next((index for index, axis in enumerate(axes) if axis.name == _FIGURE), None)
        turns = [pose_type is PoseType.P and axis.unit == "deg" for axis in axes]
        self._turns = np.array(turns, np.bool_)
        self._read = self._unread = self._returned = self._repeated = self._figure_changes = 0
        self._not_finite: list[int] = []
        self._not_finite_count = self._stutters_count = self._jumps_count = 0
        self._stutters: list[int] = []
        self._measured = [index for index, axis in enumerate(axes) if axis.unit]
        self._jumps: dict[JumpKind, list[Jump]] = {kind: [] for kind in JumpKind}
        self._least, self._most = np.full(count, np.inf), np.full(count, -np.inf)
        self._steps, self._changes, self._differences = (_FigureByAxis(count) for _ in range(3))
        self._lag = AxisLag(count)
        # `_tail` keeps the latest four set points, which `_find_jumps` compares with the next set points.
        self._tail = np.empty((0, count))
        self._tail_frames = self._tail_times = np.empty(0, np.int64)

    def add(self, rows: SetPointTable, commanded: PoseColumns, returned: PoseColumns) -> None:
        if self._start is None:
            self._start = self._start_distance(rows, commanded, returned)
        taken = rows.codes != E_SLAVE_OVERFLOW
        readable = taken & commanded.has_pose & bool(self._axes)
        finite: Bools = np.logical_and.reduce(np.isfinite(commanded.poses), axis=1)
        good = readable & finite
        self._unread += int((taken & ~readable).sum())
        not_finite = rows.frames[readable & ~finite].tolist()
        self._not_finite_count += len(not_finite)
        self._not_finite += not_finite[: MAX_LISTED - len(self._not_finite)]
        self._read += int(good.sum())
        poses, frames, times = commanded.poses[good], rows.frames[good], rows.origin + rows.times[good]
        if not len(poses):
            return
        self._least = np.minimum(self._least, poses.min(axis=0))
        self._most = np.maximum(self._most, poses.max(axis=0))
        answered = (returned.has_pose & rows.answered)[good]
        self._compare_returned(poses, returned.poses[good], answered, frames)
        self._add_steps(poses, frames, times)

    def _start_distance(
        self, rows: SetPointTable, commanded: PoseColumns, returned: PoseColumns
    ) -> _StartDistance:
        """Return the distance from the robot's position to the first set point. The position comes from the
        reply to this set point, or else from the last report before the session.
        """
        first, position, axes = commanded.poses[0], self._position, len(self._axes)
        if not axes or not np.isfinite(first).all():
            return _StartDistance()
        if returned.has_pose[0] and np.isfinite(returned.poses[0]).all():
            frames = int(rows.frames[0]), int(rows.reply_frames[0])
            distance = (first - returned.poses[0]).tolist()
            return _StartDistance(tuple(distance), Message("position-by.reply"), frames)
        if position and position.pose_type is self._pose_type and len(position.values) >= axes:
            actual = np.array(position.values[:axes])
            if np.isfinite(actual).all():
                evidence = *position.frames, int(rows.frames[0])
                return _StartDistance(tuple((first - actual).tolist()), position.known_by, evidence)
        return _StartDistance()

    def _compare_returned(
        self, commanded: Floats, returned: Floats, answered: Bools, frames: NDArray[np.int64]
    ) -> None:
        answered = answered & np.logical_and.reduce(np.isfinite(returned), axis=1)
        self._returned += int(answered.sum())
        self._lag.add(commanded, returned, answered)
        off = np.abs(self._shortest(commanded[answered] - returned[answered]))
        self._differences.add(off, frames[answered])

    def _add_steps(self, commanded: Floats, frames: NDArray[np.int64], times: NDArray[np.int64]) -> None:
        old = len(self._tail)
        points = np.vstack((self._tail, commanded))
        frames = np.concatenate((self._tail_frames, frames))
        times = np.concatenate((self._tail_times, times))
        steps = self._shortest(np.diff(points, axis=0))
        sizes = np.abs(steps)
        changes = np.abs(np.diff(steps, axis=0))
        new_steps, new_changes = max(old - 1, 0), max(old - 2, 0)
        self._steps.add(sizes[new_steps:], frames[1:][new_steps:])
        self._changes.add(changes[new_changes:], frames[2:][new_changes:])
        moves: Bools = np.logical_or.reduce(sizes > 0, axis=1)
        self._repeated += int((~moves[new_steps:]).sum())
        if self._figure is not None:
            self._figure_changes += int(np.count_nonzero(sizes[new_steps:, self._figure]))
        self._find_stutters(moves, frames, new_steps)
        self._find_jumps(steps, frames, times, new_steps)
        self._tail, self._tail_frames, self._tail_times = points[-4:], frames[-4:], times[-4:]

    def _find_stutters(self, moves: Bools, frames: NDArray[np.int64], new: int) -> None:
        """Find repeated set points in the middle of a motion. The new steps begin at index `new`."""
        first = max(new - 2, 0)
        still = ~moves[1:-1] & moves[:-2] & moves[2:]
        found = frames[2:-1][first:][still[first:]].tolist()
        self._stutters_count += len(found)
        self._stutters += found[: MAX_LISTED - len(self._stutters)]

    def _find_jumps(
        self, steps: Floats, frames: NDArray[np.int64], times: NDArray[np.int64], new: int
    ) -> None:
        sizes = np.abs(steps[:, self._measured])
        absurd = sizes > LARGEST_STEP
        counted = np.logical_or.reduce(absurd, axis=1)  # no row counts twice
        alone, stray = np.zeros_like(absurd), np.zeros_like(absurd)
        alone[1:-1] = _stands_out(sizes[1:-1], np.maximum(sizes[:-2], sizes[2:]))
        alone[counted] = False
        counted |= np.logical_or.reduce(alone, axis=1)
        # An outlier is a set point away from the path. It has two steps: one to this set point, and one back
        # to the path. If either step is an implausible or isolated jump, the set point is no outlier.
        counted[:-1] |= counted[1:]
        beside = np.maximum(sizes[:-3], sizes[3:])
        turns = np.signbit(steps[1:-2, self._measured]) != np.signbit(steps[2:-1, self._measured])
        stray[1:-2] = _stands_out(sizes[1:-2], beside) & _stands_out(sizes[2:-1], beside) & turns
        stray[counted] = False
        for kind, far, first in (
            (JumpKind.IMPLAUSIBLE, absurd, new),
            (JumpKind.ISOLATED, alone, max(new - 1, 0)),
            (JumpKind.OUTLIER, stray, max(new - 2, 0)),
        ):
            rows = first + np.flatnonzero(far[first:].any(axis=1))
            self._jumps_count += len(rows)
            found = self._jumps[kind]
            for row in rows[: MAX_LISTED - len(found)].tolist():
                axis = self._measured[int(np.where(far[row], sizes[row], -1.0).argmax())]
                name, step = self._axes[axis].name, float(steps[row, axis])
                found.append(Jump(int(frames[row + 1]), int(times[row + 1]), name, step, kind))

    def _shortest(self, steps: Floats) -> Floats:
        """Return the steps without full turns: from 179 to -179 degrees, the step is 2 degrees."""
        if self._turns.any():
            turning = steps[:, self._turns]
            steps[:, self._turns] = turning - _TURN * np.rint(turning / _TURN)
        return steps

    def facts(self, grid_ms: float) -> MotionFacts:
        start = self._start or _StartDistance()
        return MotionFacts(
            read=self._read,
            unread=self._unread,
            not_finite=self._not_finite_count,
            not_finite_frames=tuple(self._not_finite),
            pose_type_guessed=self._guessed,
            axes=tuple(
                self._axis(index, 1000.0 / grid_ms) for index in range(len(self._axes) if self._read else 0)
            ),
            returned=self._returned,
            repeated=self._repeated,
            stutters=self._stutters_count,
            stutter_frames=tuple(self._stutters),
            jumps=self._jumps_count,
            jump_list=tuple(sorted(chain(*self._jumps.values()), key=lambda jump: jump.time)[:MAX_LISTED]),
            figure_changes=self._figure_changes,
            lag_cycles=self._lag.of_all(),
            first_distance=start.distance,
            first_distance_known_by=start.known_by,
            first_distance_frames=start.frames,
        )

    def _axis(self, index: int, per_second: float) -> AxisMotion:
        step, change = self._steps.distribution(index), self._changes.distribution(index)
        return AxisMotion(
            name=self._axes[index].name,
            unit=self._axes[index].unit,
            least=float(self._least[index]),
            most=float(self._most[index]),
            step=step,
            velocity=step and step.scaled(per_second),
            acceleration=change and change.scaled(per_second * per_second),
            largest_step=self._steps.peak(index),
            largest_velocity=self._steps.peak(index, per_second),
            largest_acceleration=self._changes.peak(index, per_second * per_second),
            difference=self._differences.distribution(index),
            largest_difference=self._differences.peak(index),
            lag_cycles=self._lag.of_axis(index),
        )


def _stands_out(sizes: Floats, beside: Floats) -> Bools:
    far: Bools = (sizes > JUMP_TIMES * beside) & (sizes > SMALLEST_JUMP)
    return far
