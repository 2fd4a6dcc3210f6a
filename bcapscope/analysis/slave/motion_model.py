"""Motion that set points command: steps, velocities and accelerations per axis, and the returned poses.

A controller takes one set point per period, whenever the set point arrived. Velocity and acceleration are
therefore computed from one step per period, not from the times at which the client sent the set points.
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
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.analysis.statistics.distribution import Bools, DistributionSummary, Floats, Histogram
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import Axis

JUMP_TIMES = 5.0
"""A step is a jump if it is this many times as large as the steps on both sides.

At 8 ms no robot changes its speed that fast. A motion that only begins or ends has a small step on one side
at most.
"""

SMALLEST_JUMP = 0.2
"""Degrees or mm in one step, 25 of them per second. A smaller step is rounding or noise, not a jump."""

LARGEST_STEP = 180.0
"""Degrees or mm in one step. A larger step is a jump, whatever its neighbours are.

At 8 ms this is 22,500 degrees per second, or 22 m/s. No source gives a limit for every axis; this value is
meant to be well beyond all of them.
"""

_FIGURE = "Fig"
_TURN = 360.0


class Peak(NamedTuple):
    """The largest value, and the frame number of the request that it belongs to."""

    value: float
    frame: int


@dataclass(frozen=True, slots=True)
class AxisMotion:
    """Commanded motion of one axis in a slave-mode session.

    Velocity and acceleration assume one set point every `grid_ms`.

    Attributes:
        name: Axis, such as J1, X or Rx.
        unit: "deg", "mm", or empty.
        least: Smallest commanded position.
        most: Largest commanded position.
        step: Absolute step between successive set points; None for fewer than two.
        velocity: Step per period, in units per second; None for fewer than two set points.
        acceleration: Change of velocity, in units per second squared; None for fewer than three set points.
        difference: Absolute difference of commanded and returned position in the same call; None if no pose
            of the same type was returned.
        lag_cycles: Number of set points by which the returned pose lags behind, where both agree best. An
            estimate; None if the axis moves too little for one.
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
    """How a jump differs from motion."""

    ISOLATED = "isolated"
    """The step is far larger than the steps on both sides."""
    OUTLIER = "outlier"
    """One set point is off the path.

    This step and the next one, which goes back, are far larger than the steps on both sides.
    """
    IMPLAUSIBLE = "implausible"
    """The step is larger than `LARGEST_STEP`."""


class Jump(NamedTuple):
    """A step that no robot is meant to make.

    Attributes:
        frame: Number of the request frame that commands it.
        time: Time of that request, ns.
        axis: Axis with the largest step.
        step: Step on that axis, with sign.
    """

    frame: int
    time: int
    axis: str
    step: float
    kind: JumpKind


@dataclass(frozen=True, slots=True)
class MotionFacts:
    """Motion that the set points of a slave-mode session command, and the returned poses.

    Set points that were refused because the buffer was full are left out: the client sends the same point
    again.

    Attributes:
        read: Number of set points with a readable pose.
        unread: Number of set points with an unreadable pose or a pose of another type.
        not_finite: Number of set points with a NaN or an infinity; other figures do not include them.
        not_finite_frames: Frames of the first of them.
        pose_type_guessed: The pose type was inferred from the count of numbers.
        returned: Number of replies with a pose of the same type.
        repeated: Number of set points equal to the previous one.
        stutters: Number of repeated set points between two that move: the robot has to stop for one period.
        stutter_frames: Request frames of the first of them.
        jumps: Number of jumps of all kinds, see `JumpKind`.
        figure_changes: Number of changes of Fig; 0 for joints.
        first_distance: First set point minus the position known then, per axis; () if none is known.
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


@dataclass(frozen=True, slots=True)
class PoseTable:
    """Poses of successive set points, one row per set point.

    Attributes:
        commanded: Commanded pose; NaN if unreadable.
        returned: Returned pose; NaN without one.
        times: Time of the first request, ns.
    """

    commanded: Floats
    readable: Bools
    returned: Floats
    has_returned: Bools
    frames: NDArray[np.int64]
    times: NDArray[np.int64]


class StartDistance(NamedTuple):
    """Distance of the first set point from the position of the robot.

    Attributes:
        distance: Distance per axis; () if unknown.
        known_by: Source of the robot's position; None if unknown.
        frames: Frames that prove it; () if unknown.
    """

    distance: tuple[float, ...] = ()
    known_by: Message | None = None
    frames: tuple[int, ...] = ()


class _LargestByAxis:
    """The largest value of each axis and its frame."""

    def __init__(self, axes: int) -> None:
        self.values = np.full(axes, -1.0)
        self.frames = np.zeros(axes, np.int64)

    def add(self, values: Floats, frames: NDArray[np.int64]) -> None:
        if not len(values):
            return
        rows = values.argmax(axis=0)
        found = values[rows, np.arange(values.shape[1])]
        better = found > self.values
        self.values[better] = found[better]
        self.frames[better] = frames[rows][better]

    def peak(self, axis: int, factor: float = 1.0) -> Peak | None:
        value = float(self.values[axis])
        return Peak(value * factor, int(self.frames[axis])) if value >= 0 else None


class MotionModel:
    """Computes motion from the poses of a slave-mode session, in order."""

    def __init__(self, axes: Sequence[Axis], pose_type: PoseType | None, guessed: bool) -> None:
        self._axes = axes
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
        self._steps = [Histogram() for _ in axes]
        self._changes = [Histogram() for _ in axes]
        self._differences = [Histogram() for _ in axes]
        self._largest_step, self._largest_change = _LargestByAxis(count), _LargestByAxis(count)
        self._largest_difference = _LargestByAxis(count)
        self._lag = AxisLag(count)
        # The last four set points of the previous rows: a step, or two, is judged by its neighbours on both
        # sides.
        self._tail = np.empty((0, count))
        self._tail_frames = self._tail_times = np.empty(0, np.int64)

    def add(self, poses: PoseTable) -> None:
        finite: Bools = np.logical_and.reduce(np.isfinite(poses.commanded), axis=1)
        good = poses.readable & finite
        self._count_bad(poses, finite)
        self._read += int(good.sum())
        commanded, frames, times = poses.commanded[good], poses.frames[good], poses.times[good]
        if not len(commanded):
            return
        self._least = np.minimum(self._least, commanded.min(axis=0))
        self._most = np.maximum(self._most, commanded.max(axis=0))
        self._compare_returned(commanded, poses.returned[good], poses.has_returned[good], frames)
        self._add_steps(commanded, frames, times)

    def _count_bad(self, poses: PoseTable, finite: Bools) -> None:
        self._unread += int((~poses.readable).sum())
        odd = poses.frames[poses.readable & ~finite].tolist()
        self._not_finite_count += len(odd)
        self._not_finite += odd[: MAX_LISTED - len(self._not_finite)]

    def _compare_returned(
        self, commanded: Floats, returned: Floats, answered: Bools, frames: NDArray[np.int64]
    ) -> None:
        answered = answered & np.logical_and.reduce(np.isfinite(returned), axis=1)
        self._returned += int(answered.sum())
        self._lag.add(commanded, returned, answered)
        off = np.abs(self._shortest(commanded[answered] - returned[answered]))
        self._largest_difference.add(off, frames[answered])
        for histogram, column in zip(self._differences, off.T, strict=True):
            histogram.add(column)

    def _add_steps(self, commanded: Floats, frames: NDArray[np.int64], times: NDArray[np.int64]) -> None:
        old = len(self._tail)
        points = np.vstack((self._tail, commanded))
        frames = np.concatenate((self._tail_frames, frames))
        times = np.concatenate((self._tail_times, times))
        steps = self._shortest(np.diff(points, axis=0))
        sizes = np.abs(steps)
        changes = np.abs(np.diff(steps, axis=0))
        new_steps, new_changes = max(old - 1, 0), max(old - 2, 0)
        self._largest_step.add(sizes[new_steps:], frames[1:][new_steps:])
        self._largest_change.add(changes[new_changes:], frames[2:][new_changes:])
        for axis in range(len(self._axes)):
            self._steps[axis].add(sizes[new_steps:, axis])
            self._changes[axis].add(changes[new_changes:, axis])
        moves: Bools = np.logical_or.reduce(sizes > 0, axis=1)
        self._repeated += int((~moves[new_steps:]).sum())
        if self._figure is not None:
            self._figure_changes += int(np.count_nonzero(sizes[new_steps:, self._figure]))
        self._find_stutters(moves, frames, new_steps)
        self._find_jumps(steps, frames, times, new_steps)
        self._tail, self._tail_frames, self._tail_times = points[-4:], frames[-4:], times[-4:]

    def _find_stutters(self, moves: Bools, frames: NDArray[np.int64], new: int) -> None:
        """Find repeated set points between two that move. The last of the three steps must be new."""
        first = max(new - 2, 0)
        still = ~moves[1:-1] & moves[:-2] & moves[2:]
        found = frames[2:-1][first:][still[first:]].tolist()
        self._stutters_count += len(found)
        self._stutters += found[: MAX_LISTED - len(self._stutters)]

    def _find_jumps(
        self, steps: Floats, frames: NDArray[np.int64], times: NDArray[np.int64], new: int
    ) -> None:
        """Find jumps of each kind that the `new` steps decide; neighbours on both sides count."""
        sizes = np.abs(steps[:, self._measured])
        absurd = sizes > LARGEST_STEP
        counted = np.logical_or.reduce(absurd, axis=1)  # no row counts twice
        alone, stray = np.zeros_like(absurd), np.zeros_like(absurd)
        alone[1:-1] = _stands_out(sizes[1:-1], np.maximum(sizes[:-2], sizes[2:]))
        alone[counted] = False
        counted |= np.logical_or.reduce(alone, axis=1)
        counted[:-1] |= counted[1:]  # the way out is no outlier if the way back counts already
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
        """Take the shorter way for angles that wrap: 179 and -179 degrees are two degrees apart."""
        if self._turns.any():
            turning = steps[:, self._turns]
            steps[:, self._turns] = turning - _TURN * np.rint(turning / _TURN)
        return steps

    def facts(self, grid_ms: float, start: StartDistance) -> MotionFacts:
        """Return the facts so far, assuming one set point every `grid_ms`."""
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
        step, change = self._steps[index].distribution(), self._changes[index].distribution()
        return AxisMotion(
            name=self._axes[index].name,
            unit=self._axes[index].unit,
            least=float(self._least[index]),
            most=float(self._most[index]),
            step=step,
            velocity=step and step.scaled(per_second),
            acceleration=change and change.scaled(per_second * per_second),
            largest_step=self._largest_step.peak(index),
            largest_velocity=self._largest_step.peak(index, per_second),
            largest_acceleration=self._largest_change.peak(index, per_second * per_second),
            difference=self._differences[index].distribution(),
            largest_difference=self._largest_difference.peak(index),
            lag_cycles=self._lag.of_axis(index),
        )


def _stands_out(sizes: Floats, beside: Floats) -> Bools:
    far: Bools = (sizes > JUMP_TIMES * beside) & (sizes > SMALLEST_JUMP)
    return far
