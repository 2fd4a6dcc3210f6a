"""Pre-flight check: all checks of a trajectory that are possible before the robot moves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Message
from bcapscope.player import checks, motion_checks
from bcapscope.player.arm_limits import UNKNOWN_ARM, ArmLimits, limits_for_arm, with_limits
from bcapscope.player.checks import PreflightContext, PreflightProblem
from bcapscope.player.motion_checks import AxisFigures
from bcapscope.player.player_messages import ControllerInfo, PlayPlan
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
    """Result of the pre-flight check; `arm_name` names the arm whose limits were used.

    Attributes:
        problems: Problems found, most serious first.
        axis_figures: Figures of each axis; () if the file's times are uneven or a number is not finite.
        first_point_offsets: Distance from the robot to the first point for each axis; None if unknown.
    """

    trajectory: Trajectory
    period: float
    arm_name: Message
    problems: tuple[PreflightProblem, ...]
    axis_figures: tuple[AxisFigures, ...]
    first_point_offsets: tuple[float, ...] | None

    @property
    def is_playable(self) -> bool:
        return all(finding.severity is not Severity.ERROR for finding in self.problems)

    @property
    def needs_approach(self) -> bool:
        return any(finding.check == "first-point" for finding in self.problems)

    @property
    def seconds(self) -> float:
        """Duration in seconds from the file's times, or from `period` if the file has no times."""
        trajectory = self.trajectory
        if trajectory.period is None and trajectory.times is not None:
            return float(trajectory.times[-1])
        return (len(trajectory) - 1) * (trajectory.period or self.period)


def most_serious_first(problems: Iterable[PreflightProblem]) -> tuple[PreflightProblem, ...]:
    rank = list(Severity)
    return tuple(sorted(problems, key=lambda problem: rank.index(problem.severity)))


def run_preflight(
    trajectory: Trajectory,
    period: float,
    limits: ArmLimits = UNKNOWN_ARM,
    *,
    current_pose: Sequence[float] | None = None,
    mode: SlaveMode | None = None,
    loop: bool = False,
) -> PreflightResult:
    """Check a trajectory without moving the robot. `PreflightContext` describes the arguments."""
    case = PreflightContext(trajectory, period, limits, current_pose, mode, loop)
    findings = list(checks.check_finite(case))
    sound = not findings
    with np.errstate(all="ignore"):  # numpy must not warn about absurd times, because the checks report them
        for each in (*_FORM_CHECKS, *(_NUMBER_CHECKS if sound else ())):
            findings += each(case)
        figures = motion_checks.axis_figures(case) if sound else ()
    return PreflightResult(
        trajectory=trajectory,
        period=period,
        arm_name=limits.arm_name,
        problems=most_serious_first(findings),
        axis_figures=figures,
        first_point_offsets=motion_checks.first_point_offsets(case) if sound else None,
    )


def run_preflight_for(trajectory: Trajectory, plan: PlayPlan, controller: ControllerInfo) -> PreflightResult:
    return run_preflight(
        trajectory,
        plan.period / 1e9,
        with_limits(limits_for_arm(controller.type_name), plan.limits),
        current_pose=controller.pose,
        mode=controller.slave_mode,
        loop=plan.rounds != 1,
    )
