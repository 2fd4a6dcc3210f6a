"""A smooth curve through set points, for intermediate points and for a stop on the robot's path.

Between two points, each axis follows a polynomial of fifth degree (quintic Hermite interpolation). The speed
and acceleration at a point are those of the parabola through this point and its two neighbours. At the first
and the last point, the acceleration is 0 and the speed is the average speed to the neighbouring point.
Position, speed and acceleration are therefore continuous (C2). A wrong point changes only the two pieces of
the curve before it and the two pieces after it. For points at equal intervals, the speed never exceeds 1.75
times the highest average speed between two neighbouring points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bcapscope.protocol.slave_mode.modes import PoseType

Array = NDArray[np.float64]

ROTATION_COLUMNS = slice(3, 6)
"""Columns of P type that hold rotations in degrees; 180 and -180 are the same rotation."""

FIG_COLUMN = {PoseType.P: 6, PoseType.T: 9}
"""Column of Fig, the number of the arm's posture. Values between two whole numbers have no meaning."""

DIRECTION_COLUMNS = ORIENTATION, APPROACH = slice(3, 6), slice(6, 9)
"""Columns that hold the two unit vectors of a T-type pose. The two unit vectors are at a right angle."""


class SmoothCurve:
    def __init__(self, kind: PoseType, knots: Array, points: Array) -> None:
        """Compute the curve through `points`, an array with one row per point. `knots` holds the curve's
        parameter at each point; these parameters begin at 0 and increase.
        """
        self._kind = kind
        self._knots = knots
        self._points = points
        self._rows = unwrap_rotations(kind, points)
        self._speeds, self._accelerations = _derivatives(knots, self._rows)

    def sample(self, parameters: Array) -> Array:
        """Return the pose on the curve for each number in `parameters`. For numbers before the first knot or
        after the last knot, return the curve's first or last pose.
        """
        where = np.clip(parameters, self._knots[0], self._knots[-1])
        left = np.clip(np.searchsorted(self._knots, where, side="right") - 1, 0, len(self._knots) - 2)
        width = self._knots[left + 1] - self._knots[left]
        rows = self._interpolate(left, (where - self._knots[left]) / width, width)
        return self._to_poses(rows, left + (where >= self._knots[left + 1]))

    def _interpolate(self, left: NDArray[np.intp], part: Array, width: Array) -> Array:
        u, h = part[:, None], width[:, None]
        u3, rest = u**3, 1 - u
        # The curve between two points is the sum of two terms, one for each point (Bernstein form).
        start = rest**3 * (
            self._rows[left] * (1 + 3 * u + 6 * u**2)
            + self._speeds[left] * h * u * (1 + 3 * u)
            + self._accelerations[left] * h**2 * u**2 / 2
        )
        end = u3 * (
            self._rows[left + 1] * (1 + 3 * rest + 6 * rest**2)
            - self._speeds[left + 1] * h * rest * (1 + 3 * rest)
            + self._accelerations[left + 1] * h**2 * rest**2 / 2
        )
        return start + end

    def _to_poses(self, rows: Array, nearest: NDArray[np.intp]) -> Array:
        """Wrap rotations to ±180°, normalise the unit vectors, and copy Fig from the previous point."""
        fig = FIG_COLUMN.get(self._kind, rows.shape[1])
        if fig < rows.shape[1]:
            rows[:, fig] = self._points[nearest, fig]
        if self._kind is PoseType.P and np.abs(self._points[:, ROTATION_COLUMNS]).max() <= 180:
            rows[:, ROTATION_COLUMNS] = 180 - np.mod(180 - rows[:, ROTATION_COLUMNS], 360)
        if self._kind is PoseType.T:
            orientation = _unit_vectors(rows[:, ORIENTATION])
            approach = rows[:, APPROACH]
            across = (approach * orientation).sum(axis=1, keepdims=True)
            rows[:, ORIENTATION] = orientation
            rows[:, APPROACH] = _unit_vectors(approach - across * orientation)
        return rows


def unwrap_rotations(kind: PoseType, points: Array) -> Array:
    """Let rotations continue beyond 180° instead of jumping by 360°."""
    if kind is not PoseType.P:
        return points
    return np.hstack(
        (points[:, :3], np.unwrap(points[:, ROTATION_COLUMNS], axis=0, period=360), points[:, 6:])
    )


def paired_rows(kind: PoseType, here: Sequence[float], there: Sequence[float] | Array) -> Array:
    """Return two poses as two rows, reduced to the axes that both have. Rotations take the shorter way."""
    width = min(len(here), len(there))
    return unwrap_rotations(kind, np.vstack((here[:width], there[:width])))


def direction_turns(kind: PoseType, rows: Array) -> Array:
    """For each step between rows, return the largest turn of a direction vector in degrees, or 0."""
    turned = np.zeros(len(rows) - 1)
    for columns in DIRECTION_COLUMNS if kind is PoseType.T else ():
        way = np.linalg.norm(np.diff(rows[:, columns], axis=0), axis=1)
        turned = np.maximum(turned, np.degrees(2 * np.arcsin(np.minimum(way / 2, 1.0))))
    return turned


def matches_posture(kind: PoseType, here: Sequence[float], there: Sequence[float]) -> bool:
    """Return whether two poses have the same Fig; True if either pose lacks Fig.

    With a negative Fig, the controller chooses the posture (-2 and -3 in
    nkawa/Denso_CobottaPro900_MQTT_Control).
    """
    column = FIG_COLUMN.get(kind)
    if column is None or min(len(here), len(there)) <= column:
        return True
    return here[column] == there[column] or min(here[column], there[column]) < 0


def _derivatives(knots: Array, rows: Array) -> tuple[Array, Array]:
    widths = np.diff(knots)[:, None]
    slopes = np.diff(rows, axis=0) / widths
    speeds, accelerations = np.empty_like(rows), np.zeros_like(rows)
    speeds[0], speeds[-1] = slopes[0], slopes[-1]
    both = widths[:-1] + widths[1:]
    speeds[1:-1] = (widths[1:] * slopes[:-1] + widths[:-1] * slopes[1:]) / both
    accelerations[1:-1] = 2 * (slopes[1:] - slopes[:-1]) / both
    return speeds, accelerations


def _unit_vectors(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    units: Array = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
    return units
