"""Checks of a trajectory's numbers, pose type and times, and the results of a pre-flight check."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Message
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, Listing, Measured, Times
from bcapscope.player.arm_limits import ArmLimits
from bcapscope.player.smooth_curve import FIG_COLUMN, Array
from bcapscope.player.trajectory import Trajectory, find_gaps
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType, SlaveMode
from bcapscope.protocol.slave_mode.poses import AXES

MAX_NUMBERS = 8
"""Maximum number of set points in `PreflightProblem.points`."""

SAME_INTERVAL = 0.01
"""The pre-flight check treats two intervals as equal if they differ by at most 1 %."""

LARGEST_NUMBER = 1e9
"""Largest plausible number of mm or degrees in a set point."""

_RADIANS, _METRES = 6.3, 2.0  # values that are all below these limits look like radians or metres
_UNIT = 0.01  # how much the length of a unit vector may differ from 1
_USUAL_AXES = 6

RESAMPLE_ADVICE = Message("preflight.advice.resample")
_CORRECT = Message("preflight.advice.correct-file")


@dataclass(frozen=True, slots=True)
class PreflightProblem:
    """A problem that the pre-flight check found. An error forbids playing.

    Attributes:
        check: Name of the check, such as `speed`.
        points: Numbers of the first `MAX_NUMBERS` set points with the problem, counted from 1.
        count: Number of all set points with the problem; 0 if the problem concerns the trajectory as a whole.
    """

    check: str
    severity: Severity
    fact: Message
    advice: Message | None = None
    points: tuple[int, ...] = ()
    count: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class PreflightContext:
    """Input of the pre-flight checks; an unknown input is None. `period` is the time in seconds from one call
    of slvMove to the next. `current_pose` has the pose type of the trajectory.
    """

    trajectory: Trajectory
    period: float
    limits: ArmLimits
    current_pose: Sequence[float] | None
    mode: SlaveMode | None
    loop: bool

    @property
    def axis_count(self) -> int | None:
        """Number of joints of a known arm, or the number that the controller reports; None if unknown. Most
        controllers report eight joints, even if the robot has fewer.
        """
        if self.limits.axis_count is not None or self.current_pose is None:
            return self.limits.axis_count
        reported = len(self.current_pose)
        is_exact = self.trajectory.kind is PoseType.J and reported < len(AXES[PoseType.J])
        return reported if is_exact else None

    @property
    def step(self) -> float | None:
        """Seconds between two set points: from the file or, without times in the file, `period`. None if the
        file's intervals are unequal.
        """
        if self.trajectory.period is None and self.trajectory.times is not None:
            return None
        return self.trajectory.period or self.period


def set_point_numbers(where: ArrayLike, first: int = 1) -> tuple[tuple[int, ...], int]:
    """Return the first `MAX_NUMBERS` numbers of set points for which `where` is True, and their count."""
    found = np.flatnonzero(where)
    return tuple((found[:MAX_NUMBERS] + first).tolist()), len(found)


def error_at(
    where: ArrayLike, check: str, id: str, advice: Message | None, **places: PlaceValue
) -> Iterator[PreflightProblem]:
    """Yield an error if `where` is True for any set point. In the message, `points` is the number of these
    set points.
    """
    points, count = set_point_numbers(where)
    if count:
        fact = Message(id, **places, points=Count(count, "set-point"))
        yield PreflightProblem(check, Severity.ERROR, fact, advice, points, count)


def interval_ms(seconds: float) -> Measured:
    return Measured(seconds * 1000, "ms")


def check_finite(context: PreflightContext) -> Iterator[PreflightProblem]:
    yield from error_at(
        ~(np.abs(context.trajectory.points) <= LARGEST_NUMBER).all(axis=1),
        "not-finite",
        "preflight.not-finite",
        _CORRECT,
        total=len(context.trajectory),
        limit=Measured(LARGEST_NUMBER),
    )


def check_mode(context: PreflightContext) -> Iterator[PreflightProblem]:
    mode_, kind = context.mode, context.trajectory.kind
    if mode_ is None or mode_.pose_type is kind:
        return
    fitting = mode_.value & ~0xF | {PoseType.P: 1, PoseType.J: 2, PoseType.T: 3}[kind]
    mode = f"0x{mode_.value:03X}"
    if mode_.pose_type:
        fact = Message("preflight.mode", mode=mode, accepted=str(mode_.pose_type), kind=str(kind))
    else:
        fact = Message("preflight.mode.off", mode=mode, kind=str(kind))
    advice = Message("preflight.advice.mode", mode=f"0x{fitting:03X}")
    yield PreflightProblem("mode", Severity.ERROR, fact, advice)


def check_axes(context: PreflightContext) -> Iterator[PreflightProblem]:
    trajectory = context.trajectory
    missing = [axis.name for axis in AXES[trajectory.kind][len(trajectory.axes) :]]
    if trajectory.kind is PoseType.J and context.axis_count is not None:
        moved = [
            axis.name
            for place, axis in enumerate(trajectory.axes)
            if place >= context.axis_count and trajectory.points[:, place].any()
        ]
        if moved:
            count = Count(context.axis_count, "axis")
            fact = Message("preflight.axes.too-many", axes=count, moved=Listing(tuple(moved)))
            yield PreflightProblem("axes", Severity.ERROR, fact, Message("preflight.advice.robot"))
    if trajectory.kind is PoseType.J:
        missing = missing[: max((context.axis_count or _USUAL_AXES) - len(trajectory.axes), 0)]
    if missing:
        fact = Message("preflight.axes.missing", axes=Listing(tuple(missing)))
        yield PreflightProblem("axes", Severity.NOTE, fact)


def check_fig(context: PreflightContext) -> Iterator[PreflightProblem]:
    trajectory, column = context.trajectory, FIG_COLUMN.get(context.trajectory.kind)
    if column is None or column >= len(trajectory.axes):
        return
    values = trajectory.points[:, column]
    points, count = set_point_numbers(np.diff(values) != 0, 2)
    if count:
        before, after = (Measured(float(values[points[0] - back])) for back in (2, 1))
        fact = Message("preflight.fig-changes", changes=Times(count), before=before, after=after)
        advice = Message("preflight.advice.parts")
        yield PreflightProblem("fig", Severity.WARNING, fact, advice, points, count)
    advice, uneven = Message("preflight.advice.fig-column"), values != np.round(values)
    yield from error_at(uneven, "fig", "preflight.fig-not-whole", advice)


def check_directions(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Check that the two vectors of each T-type pose are unit vectors at a right angle."""
    if context.trajectory.kind is not PoseType.T:
        return
    orientation, approach = context.trajectory.points[:, 3:6], context.trajectory.points[:, 6:9]
    wrong = np.abs(np.linalg.norm(orientation, axis=1) - 1) > _UNIT
    wrong |= np.abs(np.linalg.norm(approach, axis=1) - 1) > _UNIT
    wrong |= np.abs((orientation * approach).sum(axis=1)) > _UNIT
    advice = Message("preflight.advice.columns")
    yield from error_at(wrong, "directions", "preflight.directions", advice)


def check_cycle(context: PreflightContext) -> Iterator[PreflightProblem]:
    mode_, cycle = context.mode, PERIOD_MS / 1000
    if mode_ is None or not mode_.pose_type or abs(context.period - cycle) <= SAME_INTERVAL * cycle:
        return
    mode, advice = f"0x{mode_.value:03X}", Message("preflight.advice.interval", interval=interval_ms(cycle))
    if context.period > cycle and mode_.underflow_is_error:
        sent = interval_ms(context.period)
        fact = Message("preflight.cycle.too-slow", mode=mode, cycle=interval_ms(cycle), interval=sent)
        yield PreflightProblem("cycle", Severity.ERROR, fact, advice)
    elif context.period < cycle and not mode_.overwrites_waiting:
        factor = Measured(cycle / context.period, digits=3)
        fact = Message("preflight.cycle.stretched", mode=mode, cycle=interval_ms(cycle), factor=factor)
        yield PreflightProblem("cycle", Severity.WARNING, fact, advice)


def check_interval(context: PreflightContext) -> Iterator[PreflightProblem]:
    trajectory = context.trajectory
    if trajectory.period is not None:
        yield from _check_period(trajectory.period, context.period)
    elif trajectory.times is None:
        fact = Message("preflight.interval.unknown", interval=interval_ms(context.period))
        advice = Message("preflight.advice.give-interval")
        yield PreflightProblem("interval", Severity.WARNING, fact, advice)
    elif len(trajectory) > 1:
        yield from _check_times(context, trajectory.times)


def _check_period(found: float, wanted: float) -> Iterator[PreflightProblem]:
    if abs(found - wanted) <= SAME_INTERVAL * wanted:
        return
    fact = Message(
        "preflight.interval",
        file=interval_ms(found),
        sent=interval_ms(wanted),
        factor=Measured(found / wanted, digits=3),
    )
    yield PreflightProblem("interval", Severity.ERROR, fact, RESAMPLE_ADVICE)


def _check_times(context: PreflightContext, times: Array) -> Iterator[PreflightProblem]:
    steps = np.diff(times)
    back = ~(steps > 0)
    if back.any():
        id = "preflight.time-order"
        yield from error_at(np.append(False, back), "time-order", id, _CORRECT)
        return
    usual = float(np.median(steps))
    points, count = set_point_numbers(find_gaps(times), 2)
    if count:
        longest = interval_ms(float(steps.max()))
        fact = Message("preflight.gap", gaps=Count(count, "gap"), longest=longest, usual=interval_ms(usual))
        advice = Message("preflight.advice.gap")
        yield PreflightProblem("gap", Severity.WARNING, fact, advice, points, count)
    uneven = float(np.abs(steps - usual).max()) > SAME_INTERVAL * usual
    if uneven:
        shortest, longest = interval_ms(float(steps.min())), interval_ms(float(steps.max()))
        sent = interval_ms(context.period)
        fact = Message("preflight.interval.uneven", shortest=shortest, longest=longest, sent=sent)
        yield PreflightProblem("interval", Severity.ERROR, fact, RESAMPLE_ADVICE)
    else:
        yield from _check_period(usual, context.period)


def check_units(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Look for numbers that seem to be radians or metres."""
    trajectory = context.trajectory
    places = slice(0, 3) if trajectory.kind is not PoseType.J else slice(0, 8)
    given = {column.unit for column in trajectory.source.columns[places]}
    rows = trajectory.points[:, places]
    if given & {"rad", "m"} or not np.ptp(rows, axis=0).any():
        return
    limit, id = _RADIANS, "preflight.units.radians"
    if trajectory.kind is not PoseType.J:
        limit, id = _METRES, "preflight.units.metres"
    largest = float(np.abs(rows).max())
    if largest < limit:
        fact, advice = Message(id, largest=Measured(largest, digits=3)), Message("preflight.advice.unit")
        yield PreflightProblem("units", Severity.WARNING, fact, advice)
