"""Pre-flight: all that can be said of a trajectory before anything moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.player import checks, checks_motion
from bcapscope.player.checks_motion import Figures
from bcapscope.player.finding import Case, Finding
from bcapscope.player.limits import UNKNOWN, Limits
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slavemode import SlaveMode

Check: TypeAlias = Callable[[Case], Iterator[Finding]]

_OF_FORM: tuple[Check, ...] = (checks.mode, checks.axes, checks.cycle, checks.interval)
_OF_NUMBERS: tuple[Check, ...] = (
    checks_motion.bounds,
    checks_motion.rest,
    checks_motion.join,
    checks_motion.first_point,
    checks.fig,
    checks.directions,
    checks.units,
    checks_motion.still,
)


@dataclass(frozen=True, slots=True, eq=False)
class Preflight:
    """What the pre-flight found.

    Attributes:
        trajectory: that was looked at.
        period: seconds between two slvMove.
        whose: limits these are.
        findings: the gravest first.
        figures: what each axis does with the times that the file has; () where they are not even, or the
            numbers do not allow to tell.
        distance: how far the first point is from where the robot is, an element an axis of the trajectory;
            None where that is not known.
    """

    trajectory: Trajectory
    period: float
    whose: str
    findings: tuple[Finding, ...]
    figures: tuple[Figures, ...]
    distance: tuple[float, ...] | None

    @property
    def is_fit(self) -> bool:
        """Whether nothing speaks against playing it."""
        return all(finding.severity is not Severity.ERROR for finding in self.findings)

    @property
    def needs_move(self) -> bool:
        """Whether the robot has to be brought to the first point by an ordinary motion."""
        return any(finding.check == "first-point" for finding in self.findings)

    @property
    def seconds(self) -> float:
        """How long it takes as the file has it, `period` apart where the file does not say."""
        trajectory = self.trajectory
        if trajectory.period is None and trajectory.times is not None:
            return float(trajectory.times[-1])
        return (len(trajectory) - 1) * (trajectory.period or self.period)


def check(
    trajectory: Trajectory,
    period: float,
    limits: Limits = UNKNOWN,
    *,
    present: Sequence[float] | None = None,
    mode: SlaveMode | None = None,
    loop: bool = False,
) -> Preflight:
    """Look at a trajectory without moving anything.

    Args:
        trajectory: as it was read or resampled.
        period: seconds between two slvMove.
        limits: of the arm.
        present: pose of the robot now, of the trajectory's kind; None where it is not known.
        mode: slave mode that it will be played in; None where it is not known.
        loop: it starts again when it has ended.
    """
    case = Case(trajectory, period, limits, present, mode, loop)
    findings = list(checks.finite(case))
    sound = not findings
    with np.errstate(all="ignore"):  # absurd times give absurd intervals, which is what is looked for
        for each in (*_OF_FORM, *(_OF_NUMBERS if sound else ())):
            findings += each(case)
        figures = checks_motion.figures(case) if sound else ()
    rank = list(Severity)
    return Preflight(
        trajectory=trajectory,
        period=period,
        whose=limits.whose,
        findings=tuple(sorted(findings, key=lambda finding: rank.index(finding.severity))),
        figures=figures,
        distance=checks_motion.distance(case) if sound else None,
    )
