"""Checks of what a trajectory is: its numbers, its kind, its times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.player.curve import FIG, Array
from bcapscope.player.finding import Case, Finding, numbered, span_text
from bcapscope.player.timing import gaps
from bcapscope.protocol.poses import AXES
from bcapscope.protocol.slavemode import PERIOD_MS, PoseType
from bcapscope.protocol.wording import counted

SAME_INTERVAL = 0.01
"""Share by which intervals may differ and still count as the same."""

LARGEST = 1e9
"""mm or degrees that count as a number at all."""

_RADIANS, _METRES = 6.3, 2.0  # below which numbers look as if they counted these
_UNIT = 0.01  # by which the length of a direction may differ from 1
_USUAL_AXES = 6

RESAMPLE = "resample it, which also gives it a smooth start and stop"


def finite(case: Case) -> Iterator[Finding]:
    """Look for what is no number, or none that a robot could go to."""
    points, count = numbered(~(np.abs(case.trajectory.points) <= LARGEST).all(axis=1))
    if count:
        told = f"{counted(count, 'set point')} of {len(case.trajectory)}"
        sentence = f"{told} {'holds' if count == 1 else 'hold'} NaN, infinity or a number beyond {LARGEST:g}"
        yield Finding("not-finite", Severity.ERROR, sentence, "put the file right", points, count)


def mode(case: Case) -> Iterator[Finding]:
    """Compare the kind of the set points with the slave mode's."""
    mode_, kind = case.mode, case.trajectory.kind
    if mode_ is None or mode_.pose_type is kind:
        return
    fitting = mode_.value & ~0xF | {PoseType.P: 1, PoseType.J: 2, PoseType.T: 3}[kind]
    told = f"takes {mode_.pose_type} type" if mode_.pose_type else "is off"
    sentence = f"slave mode 0x{mode_.value:03X} {told}, the set points are of {kind} type"
    yield Finding("mode", Severity.ERROR, sentence, f"choose mode 0x{fitting:03X}")


def axes(case: Case) -> Iterator[Finding]:
    """Compare the axes with those of the robot, and tell which are not in the file."""
    trajectory = case.trajectory
    missing = [axis.name for axis in AXES[trajectory.kind][len(trajectory.axes) :]]
    if trajectory.kind is PoseType.J and case.axis_count is not None:
        moved = [
            axis.name
            for place, axis in enumerate(trajectory.axes)
            if place >= case.axis_count and trajectory.points[:, place].any()
        ]
        if moved:
            sentence = (
                f"the robot has {counted(case.axis_count, 'axis', 'axes')}, the file moves {_and(moved)}"
            )
            yield Finding("axes", Severity.ERROR, sentence, "make sure that the file is for this robot")
    if trajectory.kind is PoseType.J:
        missing = missing[: max((case.axis_count or _USUAL_AXES) - len(trajectory.axes), 0)]
    if missing:
        kept = "keeps what the robot has now" if len(missing) == 1 else "keep what the robot has now"
        yield Finding("axes", Severity.NOTE, f"{_and(missing)}, not in the file, {kept}")


def fig(case: Case) -> Iterator[Finding]:
    """Look at the posture."""
    trajectory, column = case.trajectory, FIG.get(case.trajectory.kind)
    if column is None or column >= len(trajectory.axes):
        return
    values = trajectory.points[:, column]
    points, count = numbered(np.diff(values) != 0, 2)
    if count:
        sentence = f"Fig changes {counted(count, 'time')}, first from {values[points[0] - 2]:g} to "
        sentence += f"{values[points[0] - 1]:g}: the arm cannot change its posture from one point to the next"
        advice = "play the parts one by one, or as joints"
        yield Finding("fig", Severity.WARNING, sentence, advice, points, count)
    points, count = numbered(values != np.round(values))
    if count:
        sentence = f"Fig is no whole number in {counted(count, 'set point')}"
        yield Finding("fig", Severity.ERROR, sentence, "check which column is Fig", points, count)


def directions(case: Case) -> Iterator[Finding]:
    """Check that the vectors of T type are directions."""
    if case.trajectory.kind is not PoseType.T:
        return
    orientation, approach = case.trajectory.points[:, 3:6], case.trajectory.points[:, 6:9]
    wrong = np.abs(np.linalg.norm(orientation, axis=1) - 1) > _UNIT
    wrong |= np.abs(np.linalg.norm(approach, axis=1) - 1) > _UNIT
    wrong |= np.abs((orientation * approach).sum(axis=1)) > _UNIT
    points, count = numbered(wrong)
    if count:
        sentence = (
            f"orientation and approach are no unit vectors at a right angle in {counted(count, 'set point')}"
        )
        yield Finding("directions", Severity.ERROR, sentence, "check the columns", points, count)


def cycle(case: Case) -> Iterator[Finding]:
    """Compare slvMove with the cycle in which a controller takes set points, where that sets the pace."""
    mode_, taken = case.mode, PERIOD_MS / 1000
    if mode_ is None or not mode_.pose_type or abs(case.period - taken) <= SAME_INTERVAL * taken:
        return
    whose = f"in slave mode 0x{mode_.value:03X} a set point is taken each {span_text(taken)}"
    advice = f"choose an interval of {span_text(taken)}"
    if case.period > taken and mode_.underflow_is_error:
        sentence = f"{whose}, and slvMove goes only each {span_text(case.period)}, which would end it"
        yield Finding("cycle", Severity.ERROR, sentence, advice)
    elif case.period < taken and not mode_.overwrites:
        sentence = f"{whose}, so that this takes {taken / case.period:.3g} times as long"
        yield Finding("cycle", Severity.WARNING, sentence, advice)


def interval(case: Case) -> Iterator[Finding]:
    """Compare the times with those of slvMove."""
    trajectory = case.trajectory
    if trajectory.period is not None:
        yield from _period(trajectory.period, case.period)
    elif trajectory.times is None:
        sentence = f"the file does not tell the interval, {span_text(case.period)} is assumed"
        yield Finding("interval", Severity.WARNING, sentence, "give the interval if it is another")
    elif len(trajectory) > 1:
        yield from _times(case, trajectory.times)


def _period(found: float, wanted: float) -> Iterator[Finding]:
    if abs(found - wanted) <= SAME_INTERVAL * wanted:
        return
    sentence = (
        f"the set points are {span_text(found)} apart and slvMove goes each {span_text(wanted)}, which "
    )
    sentence += f"would move the robot at {found / wanted:.3g} times the speed"
    yield Finding("interval", Severity.ERROR, sentence, RESAMPLE)


def _times(case: Case, times: Array) -> Iterator[Finding]:
    steps = np.diff(times)
    points, count = numbered(~(steps > 0), 2)
    if count:
        sentence = f"the time of {counted(count, 'set point')} is not later than that of the one before"
        yield Finding("time-order", Severity.ERROR, sentence, "put the file right", points, count)
        return
    usual = float(np.median(steps))
    points, count = numbered(gaps(times), 2)
    if count:
        worst = float(steps.max())
        sentence = f"{counted(count, 'gap')} in the times, the longest of {span_text(worst)} where "
        sentence += f"{span_text(usual)} are usual"
        advice = "make sure that nothing is missing there: resampling draws a smooth curve across"
        yield Finding("gap", Severity.WARNING, sentence, advice, points, count)
    uneven = float(np.abs(steps - usual).max()) > SAME_INTERVAL * usual
    if uneven:
        sentence = f"the times are {span_text(float(steps.min()))} to {span_text(float(steps.max()))} apart "
        sentence += f"and slvMove goes each {span_text(case.period)}"
        yield Finding("interval", Severity.ERROR, sentence, RESAMPLE)
    else:
        yield from _period(usual, case.period)


def units(case: Case) -> Iterator[Finding]:
    """Look for numbers that seem to count something else."""
    trajectory = case.trajectory
    places = slice(0, 3) if trajectory.kind is not PoseType.J else slice(0, 8)
    given = {column.unit for column in trajectory.source.columns[places]}
    rows = trajectory.points[:, places]
    if given & {"rad", "m"} or not np.ptp(rows, axis=0).any():
        return
    largest = float(np.abs(rows).max())
    if trajectory.kind is PoseType.J and largest < _RADIANS:
        sentence = f"no joint goes beyond {largest:.3g}: these may be radians, and are taken as degrees"
        yield Finding("units", Severity.WARNING, sentence, "tell the unit if it is another")
    if trajectory.kind is not PoseType.J and largest < _METRES:
        sentence = f"X, Y and Z stay below {largest:.3g}: these may be metres, and are taken as mm"
        yield Finding("units", Severity.WARNING, sentence, "tell the unit if it is another")


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
