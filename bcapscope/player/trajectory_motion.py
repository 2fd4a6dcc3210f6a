"""Speed and acceleration of set points axis by axis, also as a share of the arm's limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bcapscope.errors import BcapError
from bcapscope.player.arm_limits import ArmLimits, ToJoints
from bcapscope.player.smooth_curve import Array, unwrap_rotations
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, Axis


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryMotion:
    """The motion of some axes in mm or degrees, with `period` seconds between two rows.

    There is one row per set point, and rotations continue beyond half a turn. Out of reach, a row is NaN.
    """

    axes: tuple[Axis, ...]
    rows: Array
    period: float

    @property
    def speeds(self) -> Array:
        """Speed at each step from one point to the next, one row per step, in units per second."""
        return np.diff(self.rows, axis=0) / self.period

    @property
    def accelerations(self) -> Array:
        """Acceleration at each pair of steps in units per second squared, computed as controllers do."""
        return np.diff(self.rows, n=2, axis=0) / (self.period * self.period)  # ** may raise an exception


def motions_of(kind: PoseType, points: Array, period: float, limits: ArmLimits) -> Iterator[TrajectoryMotion]:
    """Yield the motion of the points' own axes, then the motion of the joints if it can be computed."""
    axes = AXES[kind][: points.shape[1]]
    counted = [place for place, axis in enumerate(axes) if axis.unit]
    yield TrajectoryMotion(
        tuple(axes[place] for place in counted), unwrap_rotations(kind, points)[:, counted], period
    )
    if kind is not PoseType.J and limits.to_joints is not None:
        known = [axis for axis in AXES[PoseType.J] if limits.has_limit(axis.name)]
        yield TrajectoryMotion(tuple(known), _joints(kind, points, limits.to_joints)[:, : len(known)], period)


def _joints(kind: PoseType, points: Array, to_joints: ToJoints) -> Array:
    rows = np.full((len(points), len(AXES[PoseType.J])), np.nan)
    for place in np.flatnonzero(np.isfinite(points).all(axis=1)).tolist():
        try:
            rows[place] = to_joints(kind, tuple(points[place].tolist()))
        except BcapError:
            continue  # the arm does not reach the point; its row stays NaN
    return rows


def limit_excess(kind: PoseType, points: Array, period: float, limits: ArmLimits) -> float:
    """Return the largest share of a speed or acceleration limit that is used; infinite if out of reach."""
    worst = 0.0
    for motion in motions_of(kind, points, period, limits):
        known = [limits.limit_for(axis.name, axis.unit) for axis in motion.axes]
        shares = (
            np.abs(motion.speeds) / np.array([limit.speed for limit in known]),
            np.abs(motion.accelerations) / np.array([limit.acceleration for limit in known]),
        )
        found = max((float(share.max()) for share in shares if share.size), default=0.0)
        worst = max(worst, np.inf if np.isnan(found) else found)
    return worst
