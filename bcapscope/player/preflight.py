"""Pre-flight: all that can be said of a trajectory before anything moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.player import checks, motion_checks
from bcapscope.player.arm_limits import UNKNOWN_ARM, ArmLimits
from bcapscope.player.motion_checks import AxisFigures
from bcapscope.player.preflight_problem import PreflightContext, PreflightProblem
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slave_mode.modes import SlaveMode

Check: TypeAlias = Callable[[PreflightContext], Iterator[PreflightProblem]]

_FORM_CHECKS: tuple[Check, ...] = (
    checks.check_mode,
    checks.check_axes,
    checks.check_cycle,
    checks.check_interval,
)
_NUMBER_CHECKS: tuple[Check, ...] = (
    motion_checks.check_limits,
    motion_checks.check_rest,
    motion_checks.check_join,
    motion_checks.check_first_point,
    checks.check_fig,
    checks.check_directions,
    checks.check_units,
    motion_checks.check_movement,
)


@dataclass(frozen=True, slots=True, eq=False)
class PreflightResult:
    """What the pre-flight found.

    Attributes:
        trajectory: that was looked at.
        period: seconds between two slvMove.
        arm_name: limits these are.
        problems: the gravest first.
        axis_figures: what each axis does with the times that the file has; () where they are not even, or the
            numbers do not allow to tell.
        first_point_offsets: how far the first point is from where the robot is, an element an axis of the
            trajectory; None where that is not known.
    """

    trajectory: Trajectory
    period: float
    arm_name: str
    problems: tuple[PreflightProblem, ...]
    axis_figures: tuple[AxisFigures, ...]
    first_point_offsets: tuple[float, ...] | None

    @property
    def is_playable(self) -> bool:
        """Whether nothing speaks against playing it."""
        return all(finding.severity is not Severity.ERROR for finding in self.problems)

    @property
    def needs_approach(self) -> bool:
        """Whether the robot has to be brought to the first point by an ordinary motion."""
        return any(finding.check == "first-point" for finding in self.problems)

    @property
    def seconds(self) -> float:
        """How long it takes as the file has it, `period` apart where the file does not say."""
        trajectory = self.trajectory
        if trajectory.period is None and trajectory.times is not None:
            return float(trajectory.times[-1])
        return (len(trajectory) - 1) * (trajectory.period or self.period)


def run_preflight(
    trajectory: Trajectory,
    period: float,
    limits: ArmLimits = UNKNOWN_ARM,
    *,
    current_pose: Sequence[float] | None = None,
    mode: SlaveMode | None = None,
    loop: bool = False,
) -> PreflightResult:
    """Look at a trajectory without moving anything.

    Args:
        trajectory: as it was read or resampled.
        period: seconds between two slvMove.
        limits: of the arm.
        current_pose: pose of the robot now, of the trajectory's kind; None where it is not known.
        mode: slave mode that it will be played in; None where it is not known.
        loop: it starts again when it has ended.
    """
    case = PreflightContext(trajectory, period, limits, current_pose, mode, loop)
    findings = list(checks.check_finite(case))
    sound = not findings
    with np.errstate(all="ignore"):  # absurd times give absurd intervals, which is what is looked for
        for each in (*_FORM_CHECKS, *(_NUMBER_CHECKS if sound else ())):
            findings += each(case)
        figures = motion_checks.axis_figures(case) if sound else ()
    rank = list(Severity)
    return PreflightResult(
        trajectory=trajectory,
        period=period,
        arm_name=limits.arm_name,
        problems=tuple(sorted(findings, key=lambda finding: rank.index(finding.severity))),
        axis_figures=figures,
        first_point_offsets=motion_checks.first_point_offsets(case) if sound else None,
    )
