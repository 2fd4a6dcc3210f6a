"""Checks of a trajectory's motion: first point, distances, speeds, and standstill at the start and end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Enumeration, Measured
from bcapscope.player.arm_limits import MAX_ARM_SPEED, TrajectoryMotion, motions_of
from bcapscope.player.checks import (
    RESAMPLE_ADVICE,
    PreflightContext,
    PreflightProblem,
    error_at,
    set_point_numbers,
)
from bcapscope.player.smooth_curve import FIG_COLUMN, Array, direction_turns, matches_posture, paired_rows
from bcapscope.protocol.slave_mode.poses import Axis
from bcapscope.simulator.kinematics import AxisLimit

POSITION_TOLERANCE = 0.05
"""If the robot is farther than this from the first point, in mm or degrees, it needs an approach motion."""

_SLACK = 1.000001  # factor that raises the limits, because set points may be rounded to single precision
_DIRECTIONS = Axis("Ox..Az", "deg")
_MOVE = Message("preflight.advice.move-there")
_SLOWER, _POSITIONS = Message("preflight.advice.slower"), Message("preflight.advice.positions")
_SLOWER_OR_RESAMPLE = Message("preflight.advice.slower-or-resample")
# The check treats an axis as standing still below 10 % of its highest speed, or below 1 mm/s or 1 deg/s.
_SLOW, _CRAWL = 0.1, 1.0


class AxisFigures(NamedTuple):
    """How far and how fast an axis moves, in its unit and in seconds. An unknown limit is infinite.

    Attributes:
        acceleration: Largest acceleration. The calculation assumes that the robot stands still before the
            first point. After the last point, the robot stands still or, in a loop, goes to the first point.
        fastest: Number of the set point where the fastest step ends, counted from 1.
    """

    axis: Axis
    low: float
    high: float
    step: float
    speed: float
    acceleration: float
    fastest: int
    limit: AxisLimit


def axis_figures(context: PreflightContext) -> tuple[AxisFigures, ...]:
    """Return the figures of each axis and, for P or T, of each joint if bcapscope can compute the joints."""
    if context.step is None:
        return ()
    return tuple(
        _figures_of_axis(context, motion, place)
        for motion in _padded_motions(context)
        if not np.isnan(motion.rows).any()
        for place in range(len(motion.axes))
    )


def check_limits(context: PreflightContext) -> Iterator[PreflightProblem]:
    for motion in _padded_motions(context):
        points, count = set_point_numbers(np.isnan(motion.rows[1 : len(context.trajectory) + 1]).any(axis=1))
        if count:
            fact = Message("preflight.reach", arm=context.limits.arm_name, points=Count(count, "set-point"))
            yield PreflightProblem("reach", Severity.ERROR, fact, _POSITIONS, points, count)
            continue
        for place in range(len(motion.axes)):
            yield from _check_axis_limits(context, motion, place)
    yield from _check_turning(context)
    names = {axis.name for axis in context.trajectory.axes if axis.unit}
    if not context.limits.axes.keys() & names and context.limits.to_joints is None:
        fact, advice = Message("preflight.limits-unknown"), Message("preflight.advice.limits")
        yield PreflightProblem("limits", Severity.NOTE, fact, advice)


def check_rest(context: PreflightContext) -> Iterator[PreflightProblem]:
    motion = _own_motion(context)
    speeds = np.abs(motion.speeds)
    if not len(speeds) or context.step is None:
        return
    floor = np.maximum(_SLOW * speeds.max(axis=0), _CRAWL)
    ends = (("preflight.begins-at-speed", 0, 1), ("preflight.ends-at-speed", -1, len(context.trajectory)))
    for id, row, number in ends:
        place = int(np.argmax(speeds[row] / floor))
        if speeds[row, place] > floor[place]:
            axis = motion.axes[place]
            speed = Measured(float(speeds[row, place]), f"{axis.unit}/s", 4)
            fact = Message(id, axis=axis.name, speed=speed)
            yield PreflightProblem("rest", Severity.WARNING, fact, RESAMPLE_ADVICE, (number,), 1)
            if context.loop:
                return  # a repeated trajectory continues without rest between two rounds


def check_first_point(context: PreflightContext) -> Iterator[PreflightProblem]:
    away = first_point_offsets(context)
    if away is None or context.current_pose is None:
        return
    kind, axes, first = context.trajectory.kind, context.trajectory.axes, context.trajectory.points[0]
    far = [place for place, axis in enumerate(axes) if axis.unit and abs(away[place]) > POSITION_TOLERANCE]
    named = [_offset(axes[place], away[place]) for place in far]
    turned = float(direction_turns(kind, paired_rows(kind, context.current_pose, first))[0])
    if turned > POSITION_TOLERANCE:
        named.append(_offset(_DIRECTIONS, turned))
    if named:
        fact = Message("preflight.first-point", offsets=Enumeration(tuple(named)))
        yield PreflightProblem("first-point", Severity.WARNING, fact, _MOVE, (1,), 1)
    if not matches_posture(kind, context.current_pose, first.tolist()):
        fig = FIG_COLUMN[kind]
        wanted, current = Measured(float(first[fig])), Measured(context.current_pose[fig])
        fact = Message("preflight.first-point.fig", wanted=wanted, current=current)
        yield PreflightProblem("first-point", Severity.WARNING, fact, _MOVE, (1,), 1)


def first_point_offsets(context: PreflightContext) -> tuple[float, ...] | None:
    """Return the way from the robot to the first point for each axis. A rotation takes the shorter way."""
    if context.current_pose is None:
        return None
    both = paired_rows(context.trajectory.kind, context.current_pose, context.trajectory.points[0])
    missing = (0.0,) * (len(context.trajectory.axes) - both.shape[1])
    return (*(both[1] - both[0]).tolist(), *missing)


def check_join(context: PreflightContext) -> Iterator[PreflightProblem]:
    if not context.loop or len(context.trajectory) < 2 or context.step is None:
        return
    motion = _own_motion(context)
    last, first = next(_motions_through(context, context.trajectory.points[[-1, 0]])).rows
    back = first - last
    most = np.maximum(np.abs(np.diff(motion.rows, axis=0)).max(axis=0), POSITION_TOLERANCE)
    far = [place for place in range(len(motion.axes)) if abs(back[place]) > most[place]]
    if far:
        named = tuple(_offset(motion.axes[place], back[place]) for place in far)
        fact, advice = Message("preflight.loop", offsets=Enumeration(named)), Message("preflight.advice.loop")
        yield PreflightProblem("loop", Severity.ERROR, fact, advice, (len(context.trajectory), 1), 2)


def check_movement(context: PreflightContext) -> Iterator[PreflightProblem]:
    if not np.ptp(context.trajectory.points, axis=0).any():
        fact = Message("preflight.still", points=Count(len(context.trajectory), "set-point"))
        yield PreflightProblem("still", Severity.NOTE, fact)


def _own_motion(context: PreflightContext) -> TrajectoryMotion:
    return next(_motions_through(context, context.trajectory.points))


def _padded_motions(context: PreflightContext) -> Iterator[TrajectoryMotion]:
    """Add a standstill at the start. At the end, add a standstill or, in a loop, the next two points."""
    points = context.trajectory.points
    after = points[:2] if context.loop else points[-1:]
    return _motions_through(context, np.vstack((points[:1], points, after)))


def _motions_through(context: PreflightContext, points: Array) -> Iterator[TrajectoryMotion]:
    return motions_of(context.trajectory.kind, points, context.step or context.period, context.limits)


def _figures_of_axis(context: PreflightContext, motion: TrajectoryMotion, place: int) -> AxisFigures:
    axis, column = motion.axes[place], motion.rows[:, place]
    speeds = np.abs(motion.speeds[:, place])
    fastest = int(np.argmax(speeds))
    return AxisFigures(
        axis=axis,
        low=float(column.min()),
        high=float(column.max()),
        step=float(speeds[fastest]) * motion.period,
        speed=float(speeds[fastest]),
        acceleration=float(np.abs(motion.accelerations[:, place]).max()),
        fastest=fastest % len(context.trajectory) + 1,
        limit=context.limits.known_limit(axis.name),
    )


def _check_axis_limits(
    context: PreflightContext, motion: TrajectoryMotion, place: int
) -> Iterator[PreflightProblem]:
    axis, count = motion.axes[place], len(context.trajectory)
    limit, unit = context.limits.limit_for(axis.name, axis.unit), axis.unit
    values = motion.rows[1 : count + 1, place]
    outside = (values < limit.low) | (values > limit.high)
    yield from error_at(
        outside,
        "range",
        "preflight.range",
        _POSITIONS,
        axis=axis.name,
        low=Measured(float(values.min())),
        high=Measured(float(values.max()), unit),
        low_limit=Measured(limit.low),
        high_limit=Measured(limit.high),
    )
    if context.step is None:
        return
    is_known = limit.speed != MAX_ARM_SPEED.get(unit)
    speed_id = "preflight.speed" if is_known else "preflight.speed.any-arm"
    for check, id, advice, rates, most, per in (
        ("speed", speed_id, _SLOWER, motion.speeds, limit.speed, "/s"),
        (
            "acceleration",
            "preflight.acceleration",
            _SLOWER_OR_RESAMPLE,
            motion.accelerations,
            limit.acceleration,
            "/s²",
        ),
    ):
        found = np.abs(rates[:, place])
        places = {check: Measured(float(found.max()), f"{unit}{per}", 4), "limit": Measured(most)}
        beyond = _mark_set_points(found > most * _SLACK, count)
        yield from error_at(beyond, check, id, advice, axis=axis.name, **places)


def _check_turning(context: PreflightContext) -> Iterator[PreflightProblem]:
    if context.step is None:
        return
    points, most = context.trajectory.points, MAX_ARM_SPEED[_DIRECTIONS.unit]
    after = points[:1] if context.loop else points[-1:]
    speeds = direction_turns(context.trajectory.kind, np.vstack((points[:1], points, after))) / context.step
    yield from error_at(
        _mark_set_points(speeds > most, len(points)),
        "speed",
        "preflight.speed.any-arm",
        _SLOWER,
        axis=_DIRECTIONS.name,
        speed=Measured(float(speeds.max()), f"{_DIRECTIONS.unit}/s", 4),
    )


def _mark_set_points(where: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Return for each of the `count` set points whether one of its rows in `where` is True. The rows of
    `where` belong to the set points 1 to `count`, and then again to set point 1 and the following set points.
    """
    at = where[:count].copy()
    rest = where[count : 2 * count]
    at[: len(rest)] |= rest
    return at


def _offset(axis: Axis, offset: float) -> Message:
    return Message("preflight.offset", axis=axis.name, offset=f"{offset:+.4g} {axis.unit}")
