"""Trajectories: set points with the axes in slvMove's order, time intervals, gaps and the source file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.messages.places import Measured
from bcapscope.player.smooth_curve import Array
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType
from bcapscope.protocol.slave_mode.poses import AXES, SHORTEST_POSE, Axis

MAX_POINTS = 5_000_000
"""Maximum number of set points of a trajectory. 5,000,000 set points last 11 h at 8 ms, and need 320 MB."""


class TrajectoryError(InputError):
    """A file holds no valid trajectory. Line and column of the error, counted from 1; None if unknown."""

    def __init__(self, reason: Message, line: int | None = None, column: int | None = None) -> None:
        if line is not None and column is not None:
            reason = Message("trajectory.at-line-column", line=line, column=column, reason=reason)
        elif line is not None:
            reason = Message("trajectory.at-line", line=line, reason=reason)
        elif column is not None:
            reason = Message("trajectory.at-column", column=column, reason=reason)
        super().__init__(reason)


@dataclass(frozen=True, slots=True)
class Column:
    """A column or element of a file: the numbers of one axis, or the times. A missing name or unit is "".

    Attributes:
        axis: Name of the axis, such as `J1`, or `time`.
        position: Number of the column or element in the file, from 1.
        unit: Unit of the numbers in the file: `deg`, `rad`, `mm`, `m`, `s`, `ms`.
        factor: Factor that converts the file's numbers to mm, degrees or seconds.
    """

    axis: str
    position: int
    name: str = ""
    unit: str = ""
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class TrajectorySource:
    """Where a trajectory comes from, and how it was read.

    Attributes:
        file_format: Kind of the file, with the encoding of a text file; None without a file.
        part: Name of the trajectory if the file has several.
        columns: Columns in the order of `Trajectory.axes`, then the columns of times and counter, if any.
        notes: One clause for each thing that the reader assumed, left out or converted.
    """

    path: str
    file_format: Message | None = None
    part: Message | None = None
    columns: tuple[Column, ...] = ()
    notes: tuple[Message, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Set points of one pose type. Raises ValueError if an array has a wrong number of rows or columns.

    Attributes:
        points: Read-only, in mm and degrees: one row per set point, one column per axis in the order of
            slvMove: 1 to 8 joints, 6 or 7 numbers of P type, 9 or 10 of T type.
        period: Seconds between two set points according to the file; None if the file states no period.
        times: Read-only: seconds from the first set point to each set point; None if the file has no times.
    """

    kind: PoseType
    points: NDArray[np.float64]
    source: TrajectorySource
    period: float | None = None
    times: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or not MIN_COLUMNS[self.kind] <= self.points.shape[1] <= len(
            AXES[self.kind]
        ):
            raise ValueError(f"points of shape {self.points.shape} do not fit pose type {self.kind}")
        if not 0 < len(self.points) <= MAX_POINTS:
            raise ValueError(f"a trajectory cannot have {len(self.points)} set points")
        if self.times is not None and self.times.shape != (len(self.points),):
            raise ValueError(f"times of shape {self.times.shape} do not fit {len(self.points)} set points")
        self.points.flags.writeable = False
        if self.times is not None:
            self.times.flags.writeable = False

    def __len__(self) -> int:
        return len(self.points)

    @property
    def axes(self) -> tuple[Axis, ...]:
        return AXES[self.kind][: self.points.shape[1]]

    def set_point(self, row: int) -> tuple[float, ...]:
        return tuple(self.points[row].tolist())

    def completed(self, current_pose: Sequence[float]) -> Trajectory:
        """Add the axes that the file lacks, with the robot's current values, so that these axes do not move.

        The result has 7 columns for P type, 8 for J type, 10 for T type. Unknown values are 0.
        """
        have, width = self.points.shape[1], len(AXES[self.kind])
        missing = np.zeros(width - have)
        held = np.asarray(current_pose[have:width], dtype=np.float64)
        missing[: len(held)] = held
        return replace(self, points=np.hstack((self.points, np.tile(missing, (len(self.points), 1)))))


def float_or_nan(value: object) -> float:
    try:
        return float("nan") if isinstance(value, bool) else float(value)  # type: ignore[arg-type]  # as caught
    except (TypeError, ValueError, OverflowError):
        return float("nan")


MIN_COLUMNS = {**SHORTEST_POSE, PoseType.J: 1, PoseType.T: 9}
"""Minimum number of columns by pose type; a file may have fewer joints than slvMove needs."""


CYCLES = (PERIOD_MS / 1000, 0.001)
"""Cycle times of set points, seconds (DENSO Wave 2009, How to use the Slave mode)."""

EVEN_TOLERANCE = 0.01
"""Set points have even intervals if each interval differs from the usual interval by at most 1 %."""

MAX_PARTS = 64
"""Maximum number of trajectories into which the reader splits records with gaps."""

GAP_FACTOR = 1.5
"""An interval is a gap if it is longer than this multiple of the usual interval."""

_CYCLE_TOLERANCE = 0.05


class SetPointTiming(NamedTuple):
    """Timing in s. `period` is None if the intervals are uneven, `times` if the file has no useful times."""

    period: float | None
    times: Array | None
    notes: tuple[Message, ...] = ()


def timing_from_due_times(times: Array) -> SetPointTiming:
    """Compute the timing from the times, in seconds, at which set points are due."""
    shifted = times - times[0]
    steps = np.diff(shifted)
    if not len(steps) or not np.isfinite(steps).all():
        return SetPointTiming(None, shifted)
    usual = float(np.median(steps))
    even = usual > 0 and float(np.abs(steps - usual).max()) <= EVEN_TOLERANCE * usual
    return SetPointTiming(round(usual, 9) if even else None, shifted)


def timing_from_send_times(times: Array) -> SetPointTiming:
    """Compute the timing from the times, in seconds, at which set points were sent.

    A controller takes one set point per cycle. If the median interval is close to one of `CYCLES`, the
    returned `period` is that cycle time, and `times` is None.
    """
    steps = np.diff(times)
    if not len(steps):
        return SetPointTiming(CYCLES[0], None)
    usual = float(np.median(steps))
    cycle = next((cycle for cycle in CYCLES if abs(usual - cycle) <= _CYCLE_TOLERANCE * cycle), None)
    if cycle is None:
        return timing_from_due_times(times)
    longest = float(steps.max())
    notes = [Message("trajectory.note.cycle", cycle=Measured(cycle * 1000, "ms"))]
    if longest > 2 * cycle:
        notes.append(Message("trajectory.note.pause", longest=Measured(longest * 1000, "ms", 3)))
    return SetPointTiming(cycle, None, tuple(notes))


def find_gaps(times: Array) -> NDArray[np.bool_]:
    """Return for each interval whether set points may be missing in it."""
    steps = np.diff(times)
    return np.asarray(steps > GAP_FACTOR * np.median(steps))


def find_runs(counter: Array) -> tuple[tuple[tuple[int, int], ...], float | None]:
    """Split the records of a log at gaps. `counter` holds one number per record, which grows steadily unless
    records are missing.

    Return a pair for each part (first record, record after the last), and the median increase of the counter
    per record. If the counter does not grow, is not finite, or has at least `MAX_PARTS` gaps, return one part
    for the whole log and None.
    """
    whole = ((0, len(counter)),)
    steps = np.diff(counter)
    if not len(steps) or not np.isfinite(steps).all():
        return whole, None
    usual = float(np.median(steps))
    if usual <= 0:
        return whole, None
    breaks = np.flatnonzero((steps > GAP_FACTOR * usual) | (steps <= 0)) + 1
    if len(breaks) >= MAX_PARTS:
        return whole, None
    edges = [0, *breaks.tolist(), len(counter)]
    return tuple(pairwise(edges)), usual
