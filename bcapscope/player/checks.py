"""Checks of a trajectory's numbers, type and times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bcapscope.analysis.finding import Severity
from bcapscope.player.preflight_problem import (
    PreflightContext,
    PreflightProblem,
    interval_text,
    set_point_numbers,
)
from bcapscope.player.set_point_timing import find_gaps
from bcapscope.player.smooth_curve import FIG_COLUMN, Array
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.protocol.text_format import counted

SAME_INTERVAL = 0.01
"""Share by which equal intervals may differ."""

LARGEST_NUMBER = 1e9
"""Largest number of mm or degrees that is accepted at all."""

_RADIANS, _METRES = 6.3, 2.0  # smaller numbers look like radians or metres
_UNIT = 0.01  # the length of a unit vector may differ from 1 by this much
_USUAL_AXES = 6

RESAMPLE_ADVICE = "resample it, which also gives it a smooth start and stop"


def check_finite(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Look for NaN, infinity and absurd numbers."""
    points, count = set_point_numbers(~(np.abs(context.trajectory.points) <= LARGEST_NUMBER).all(axis=1))
    if count:
        told = f"{counted(count, 'set point')} of {len(context.trajectory)}"
        sentence = (
            f"{told} {'holds' if count == 1 else 'hold'} NaN, infinity or a number beyond {LARGEST_NUMBER:g}"
        )
        yield PreflightProblem("not-finite", Severity.ERROR, sentence, "put the file right", points, count)


def check_mode(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Compare the pose type of the set points with that of the slave mode."""
    mode_, kind = context.mode, context.trajectory.kind
    if mode_ is None or mode_.pose_type is kind:
        return
    fitting = mode_.value & ~0xF | {PoseType.P: 1, PoseType.J: 2, PoseType.T: 3}[kind]
    told = f"takes {mode_.pose_type} type" if mode_.pose_type else "is off"
    sentence = f"slave mode 0x{mode_.value:03X} {told}, the set points are of {kind} type"
    yield PreflightProblem("mode", Severity.ERROR, sentence, f"choose mode 0x{fitting:03X}")


def check_axes(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Compare the axes with those of the robot, and note which the file lacks."""
    trajectory = context.trajectory
    missing = [axis.name for axis in AXES[trajectory.kind][len(trajectory.axes) :]]
    if trajectory.kind is PoseType.J and context.axis_count is not None:
        moved = [
            axis.name
            for place, axis in enumerate(trajectory.axes)
            if place >= context.axis_count and trajectory.points[:, place].any()
        ]
        if moved:
            axes = counted(context.axis_count, "axis", "axes")
            sentence = f"the robot has {axes}, the file moves {_join_names(moved)}"
            yield PreflightProblem(
                "axes", Severity.ERROR, sentence, "make sure that the file is for this robot"
            )
    if trajectory.kind is PoseType.J:
        missing = missing[: max((context.axis_count or _USUAL_AXES) - len(trajectory.axes), 0)]
    if missing:
        kept = "keeps what the robot has now" if len(missing) == 1 else "keep what the robot has now"
        yield PreflightProblem("axes", Severity.NOTE, f"{_join_names(missing)}, not in the file, {kept}")


def check_fig(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Check that Fig is a whole number and does not change."""
    trajectory, column = context.trajectory, FIG_COLUMN.get(context.trajectory.kind)
    if column is None or column >= len(trajectory.axes):
        return
    values = trajectory.points[:, column]
    points, count = set_point_numbers(np.diff(values) != 0, 2)
    if count:
        sentence = f"Fig changes {counted(count, 'time')}, first from {values[points[0] - 2]:g} to "
        sentence += f"{values[points[0] - 1]:g}: the arm cannot change its posture from one point to the next"
        advice = "play the parts one by one, or as joints"
        yield PreflightProblem("fig", Severity.WARNING, sentence, advice, points, count)
    points, count = set_point_numbers(values != np.round(values))
    if count:
        sentence = f"Fig is no whole number in {counted(count, 'set point')}"
        yield PreflightProblem("fig", Severity.ERROR, sentence, "check which column is Fig", points, count)


def check_directions(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Check that the vectors of T type are unit vectors at a right angle."""
    if context.trajectory.kind is not PoseType.T:
        return
    orientation, approach = context.trajectory.points[:, 3:6], context.trajectory.points[:, 6:9]
    wrong = np.abs(np.linalg.norm(orientation, axis=1) - 1) > _UNIT
    wrong |= np.abs(np.linalg.norm(approach, axis=1) - 1) > _UNIT
    wrong |= np.abs((orientation * approach).sum(axis=1)) > _UNIT
    points, count = set_point_numbers(wrong)
    if count:
        sentence = (
            f"orientation and approach are no unit vectors at a right angle in {counted(count, 'set point')}"
        )
        yield PreflightProblem("directions", Severity.ERROR, sentence, "check the columns", points, count)


def check_cycle(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Compare the time between slvMove with the controller's cycle time."""
    mode_, taken = context.mode, PERIOD_MS / 1000
    if mode_ is None or not mode_.pose_type or abs(context.period - taken) <= SAME_INTERVAL * taken:
        return
    whose = f"in slave mode 0x{mode_.value:03X} a set point is taken each {interval_text(taken)}"
    advice = f"choose an interval of {interval_text(taken)}"
    if context.period > taken and mode_.underflow_is_error:
        sentence = f"{whose}, and slvMove goes only each {interval_text(context.period)}, which would end it"
        yield PreflightProblem("cycle", Severity.ERROR, sentence, advice)
    elif context.period < taken and not mode_.overwrites_waiting:
        sentence = f"{whose}, so that this takes {taken / context.period:.3g} times as long"
        yield PreflightProblem("cycle", Severity.WARNING, sentence, advice)


def check_interval(context: PreflightContext) -> Iterator[PreflightProblem]:
    """Compare the times of the file with those of slvMove."""
    trajectory = context.trajectory
    if trajectory.period is not None:
        yield from _check_period(trajectory.period, context.period)
    elif trajectory.times is None:
        sentence = f"the file does not tell the interval, {interval_text(context.period)} is assumed"
        yield PreflightProblem("interval", Severity.WARNING, sentence, "give the interval if it is another")
    elif len(trajectory) > 1:
        yield from _check_times(context, trajectory.times)


def _check_period(found: float, wanted: float) -> Iterator[PreflightProblem]:
    if abs(found - wanted) <= SAME_INTERVAL * wanted:
        return
    sentence = (
        f"the set points are {interval_text(found)} apart and slvMove goes each {interval_text(wanted)}, "
    )
    sentence += f"which would move the robot at {found / wanted:.3g} times the speed"
    yield PreflightProblem("interval", Severity.ERROR, sentence, RESAMPLE_ADVICE)


def _check_times(context: PreflightContext, times: Array) -> Iterator[PreflightProblem]:
    steps = np.diff(times)
    points, count = set_point_numbers(~(steps > 0), 2)
    if count:
        sentence = f"the time of {counted(count, 'set point')} is not later than that of the one before"
        yield PreflightProblem("time-order", Severity.ERROR, sentence, "put the file right", points, count)
        return
    usual = float(np.median(steps))
    points, count = set_point_numbers(find_gaps(times), 2)
    if count:
        worst = float(steps.max())
        sentence = f"{counted(count, 'gap')} in the times, the longest of {interval_text(worst)} where "
        sentence += f"{interval_text(usual)} are usual"
        advice = "make sure that nothing is missing there: resampling draws a smooth curve across"
        yield PreflightProblem("gap", Severity.WARNING, sentence, advice, points, count)
    uneven = float(np.abs(steps - usual).max()) > SAME_INTERVAL * usual
    if uneven:
        sentence = (
            f"the times are {interval_text(float(steps.min()))} to {interval_text(float(steps.max()))} apart "
        )
        sentence += f"and slvMove goes each {interval_text(context.period)}"
        yield PreflightProblem("interval", Severity.ERROR, sentence, RESAMPLE_ADVICE)
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
    largest = float(np.abs(rows).max())
    if trajectory.kind is PoseType.J and largest < _RADIANS:
        sentence = f"no joint goes beyond {largest:.3g}: these may be radians, and are taken as degrees"
        yield PreflightProblem("units", Severity.WARNING, sentence, "tell the unit if it is another")
    if trajectory.kind is not PoseType.J and largest < _METRES:
        sentence = f"X, Y and Z stay below {largest:.3g}: these may be metres, and are taken as mm"
        yield PreflightProblem("units", Severity.WARNING, sentence, "tell the unit if it is another")


def _join_names(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
