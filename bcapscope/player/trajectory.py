"""Trajectories: set points in the order of slvMove, and where they are from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcapscope.errors import BcapError
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, SHORTEST_POSE, Axis

MAX_POINTS = 5_000_000
"""Set points that a trajectory may have: eleven hours at 8 ms, and 320 MB."""


class TrajectoryError(BcapError, ValueError):
    """A file gives no trajectory.

    Attributes:
        line: counted from 1; None where the fault has no line.
        column: counted from 1; None likewise.
    """

    def __init__(self, message: str, line: int | None = None, column: int | None = None) -> None:
        """Tell why, where it is known with the place in front."""
        places = (("line", line), ("column", column))
        place = ", ".join(f"{noun} {number}" for noun, number in places if number is not None)
        super().__init__(f"{place}: {message}" if place else message)
        self.line = line
        self.column = column


@dataclass(frozen=True, slots=True)
class Column:
    """Where the numbers of one axis, or the times, are from.

    Attributes:
        axis: name as in a pose, such as `J1`, or `time`.
        position: of the column or element in the file, counted from 1.
        name: what the file calls it; empty where it has no names.
        unit: what the file counts in: `deg`, `rad`, `mm`, `m`, `s`, `ms`, or empty.
        factor: what numbers in the file are multiplied with.
    """

    axis: str
    position: int
    name: str = ""
    unit: str = ""
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class TrajectorySource:
    """Where a trajectory is from and how it was read.

    Attributes:
        path: of the file, as it was given.
        file_format: what kind of file it is, in words.
        part: which of several trajectories in the file; empty where there is one.
        columns: an element an axis in the order of `Trajectory.axes`, then those of times and counter if any.
        notes: what was assumed, left out or converted, a clause each.
    """

    path: str
    file_format: str
    part: str = ""
    columns: tuple[Column, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Set points of one pose type.

    Attributes:
        kind: P, J or T.
        points: float64, one row a set point, one column an axis in the order of slvMove: mm, degrees (mm for
            linear joints), Fig and direction cosines as they are. There are as many columns as the file has
            axes: 1 to 8 joints, 6 or 7 numbers of P type, 9 or 10 of T type. Not writeable.
        source: where it is from.
        period: seconds between two set points, as the file says; None where it does not.
        times: float64, seconds of each set point from the first; None where the file has none. Not writeable.

    Raises:
        ValueError: shapes that do not fit the kind or each other.
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
            raise ValueError(f"points of shape {self.points.shape} are no poses of type {self.kind}")
        if not 0 < len(self.points) <= MAX_POINTS:
            raise ValueError(f"{len(self.points)} set points are no trajectory")
        if self.times is not None and self.times.shape != (len(self.points),):
            raise ValueError(f"times of shape {self.times.shape} for {len(self.points)} set points")
        self.points.flags.writeable = False
        if self.times is not None:
            self.times.flags.writeable = False

    def __len__(self) -> int:
        return len(self.points)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes of the columns, in order."""
        return AXES[self.kind][: self.points.shape[1]]

    def set_point(self, row: int, current_pose: Sequence[float] = ()) -> tuple[float, ...]:
        """Return one set point with all numbers that slvMove takes, see `completed`."""
        return tuple(_complete(self.kind, self.points[row : row + 1], current_pose)[0].tolist())

    def completed(self, current_pose: Sequence[float] = ()) -> Trajectory:
        """Fill in the axes that the file does not have, so that they stay where they are.

        Args:
            current_pose: the pose that the robot has now, of the same kind, for the axes that are missing;
                where it is shorter, joints get 0, which is what axes that a robot does not have count, and so
                does Fig.

        Returns:
            A trajectory with 7 columns of P type, 8 of J type, 10 of T type.
        """
        return replace(self, points=_complete(self.kind, self.points, current_pose))


MIN_COLUMNS = {**SHORTEST_POSE, PoseType.J: 1, PoseType.T: 9}
"""Columns that a trajectory has at least, by its kind: a file may name fewer joints than slvMove takes."""


def _complete(kind: PoseType, points: NDArray[np.float64], present: Sequence[float]) -> NDArray[np.float64]:
    have, width = points.shape[1], len(AXES[kind])
    missing = np.zeros(width - have)
    held = np.asarray(present[have:width], dtype=np.float64)
    missing[: len(held)] = held
    return np.hstack((points, np.broadcast_to(missing, (len(points), width - have))))
