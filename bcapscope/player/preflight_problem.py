"""What the pre-flight says: one finding a check, or one an axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bcapscope.analysis.finding import Severity
from bcapscope.player.arm_limits import ArmLimits
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slave_mode.modes import PoseType, SlaveMode
from bcapscope.protocol.slave_mode.poses import AXES

MAX_NUMBERS = 8
"""Set points that a finding names; how many there are is told besides."""


@dataclass(frozen=True, slots=True)
class PreflightProblem:
    """Something that speaks against playing a trajectory, or is worth knowing.

    Attributes:
        check: what was looked at, such as `speed`.
        severity: an error speaks against playing at all.
        sentence: one sentence in plain English.
        advice: what to do, one sentence; empty where there is nothing to do.
        points: numbers of set points that show it, from 1, at most `MAX_NUMBERS`.
        count: how many there are; 0 where it concerns no single ones.
    """

    check: str
    severity: Severity
    sentence: str
    advice: str = ""
    points: tuple[int, ...] = ()
    count: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class PreflightContext:
    """What a trajectory is checked against.

    Attributes:
        trajectory: which has the axes that its file has.
        period: seconds between two slvMove.
        limits: of the arm.
        current_pose: pose of the robot now, of the trajectory's kind; None where it is not known.
        mode: slave mode that it will be played in; None where it is not known.
        loop: it starts again when it has ended.
    """

    trajectory: Trajectory
    period: float
    limits: ArmLimits
    current_pose: Sequence[float] | None
    mode: SlaveMode | None
    loop: bool

    @property
    def axis_count(self) -> int | None:
        """Joints of the robot: as many as its arm is known to have, or as it tells; None if nobody knows.

        Most controllers tell eight, of which those are 0 that the robot has not; eight says nothing.
        """
        if self.limits.axis_count is not None or self.current_pose is None:
            return self.limits.axis_count
        told = len(self.current_pose)
        return told if self.trajectory.kind is PoseType.J and told < len(AXES[PoseType.J]) else None

    @property
    def step(self) -> float | None:
        """Seconds between two set points as the file means them; None where they are not even."""
        if self.trajectory.period is None and self.trajectory.times is not None:
            return None
        return self.trajectory.period or self.period


def set_point_numbers(where: ArrayLike, first: int = 1) -> tuple[tuple[int, ...], int]:
    """Return the numbers of the set points for which an array is true, and how many there are.

    Args:
        where: one truth value a set point.
        first: number that the first element has.
    """
    found = np.flatnonzero(where)
    return tuple((found[:MAX_NUMBERS] + first).tolist()), len(found)


def interval_text(seconds: float) -> str:
    """Write an interval in milliseconds."""
    return f"{seconds * 1000:.6g} ms"
