"""Results of the pre-flight check: each check reports one problem, or one problem per axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, Measured
from bcapscope.player.arm_limits import ArmLimits
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slave_mode.modes import PoseType, SlaveMode
from bcapscope.protocol.slave_mode.poses import AXES

MAX_NUMBERS = 8
"""Maximum number of set points that a problem lists; `PreflightProblem.count` is their total number."""


@dataclass(frozen=True, slots=True)
class PreflightProblem:
    """A problem that forbids playing a trajectory, a warning, or a remark.

    Attributes:
        check: Name of the check, such as `speed`.
        severity: Severity of the problem; an error forbids playing.
        fact: One clause that says what is wrong.
        advice: One clause that says what to do; None if there is nothing to do.
        points: Numbers of set points that show the problem, from 1, at most `MAX_NUMBERS`.
        count: Total number of such set points; 0 if the problem concerns the trajectory as a whole.
    """

    check: str
    severity: Severity
    fact: Message
    advice: Message | None = None
    points: tuple[int, ...] = ()
    count: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class PreflightContext:
    """The trajectory, and the facts that the checks compare with it; an unknown fact is None.

    Attributes:
        trajectory: The trajectory as read or resampled, with the axes that its file has.
        period: Seconds between two calls of slvMove.
        current_pose: Current pose of the robot, in the pose type of the trajectory.
        loop: Whether the trajectory starts again at its end.
    """

    trajectory: Trajectory
    period: float
    limits: ArmLimits
    current_pose: Sequence[float] | None
    mode: SlaveMode | None
    loop: bool

    @property
    def axis_count(self) -> int | None:
        """Number of joints of the known arm, or that the controller reports; None if unknown.

        Most controllers report eight joints, with 0 for joints that the robot lacks. A report of eight joints
        therefore does not prove that the robot has eight.
        """
        if self.limits.axis_count is not None or self.current_pose is None:
            return self.limits.axis_count
        reported = len(self.current_pose)
        is_exact = self.trajectory.kind is PoseType.J and reported < len(AXES[PoseType.J])
        return reported if is_exact else None

    @property
    def step(self) -> float | None:
        """Seconds between two set points according to the file; None if the file's times are uneven."""
        if self.trajectory.period is None and self.trajectory.times is not None:
            return None
        return self.trajectory.period or self.period


def set_point_numbers(where: ArrayLike, first: int = 1) -> tuple[tuple[int, ...], int]:
    """Return the first `MAX_NUMBERS` numbers of set points for which an array is true, and their count."""
    found = np.flatnonzero(where)
    return tuple((found[:MAX_NUMBERS] + first).tolist()), len(found)


def problem_at(
    where: ArrayLike,
    check: str,
    severity: Severity,
    id: str,
    advice: Message | None,
    *,
    first: int = 1,
    **places: PlaceValue,
) -> Iterator[PreflightProblem]:
    """Yield a problem if an array is true for any set point; the place `points` holds their count."""
    points, count = set_point_numbers(where, first)
    if count:
        fact = Message(id, **places, points=Count(count, "set-point"))
        yield PreflightProblem(check, severity, fact, advice, points, count)


def interval_ms(seconds: float) -> Measured:
    return Measured(seconds * 1000, "ms")
