"""Checks of how a trajectory moves: where from, how far, how fast, and whether it begins and ends at rest."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.finding import Severity
from bcapscope.player.checks import RESAMPLE
from bcapscope.player.curve import FIG, Array, has_posture, turns, unwound
from bcapscope.player.finding import Case, Finding, numbered
from bcapscope.player.limits import FASTEST
from bcapscope.player.motion import Motion, motions
from bcapscope.protocol.poses import Axis
from bcapscope.protocol.wording import counted
from bcapscope.simulator.kinematics import AxisLimit

NEAR = 0.05
"""mm or degrees that the first point may be away from where the robot is, without a Move there."""

_SLACK = 1.000001  # rounding of single-precision set points is no excess
_DIRECTIONS = Axis("Ox..Az", "deg")
_MOVE = "move there slowly first"
_TOO_FAST, _SLOWER = "more than any arm does", "play it more slowly, or look for a jump there"
_SLOW, _CRAWL = 0.1, 1.0  # share of the top speed, and units a second, that count as rest at either end


class Figures(NamedTuple):
    """What one axis does.

    Attributes:
        axis: name and unit.
        low: smallest value.
        high: largest value.
        step: largest step from one set point to the next.
        speed: largest, a second.
        acceleration: largest, a second squared, rest before the first and after the last point counted.
        fastest: number of the set point that the fastest step leads to, from 1.
        limit: of the axis, infinite where it is not known.
    """

    axis: Axis
    low: float
    high: float
    step: float
    speed: float
    acceleration: float
    fastest: int
    limit: AxisLimit


def figures(case: Case) -> tuple[Figures, ...]:
    """Return what each axis does, the joints behind the others where they can be computed."""
    if case.step is None:
        return ()
    return tuple(
        _figures(case, motion, place)
        for motion in _motions(case)
        if not np.isnan(motion.rows).any()
        for place in range(len(motion.axes))
    )


def bounds(case: Case) -> Iterator[Finding]:
    """Compare positions, speeds and accelerations with the limits of each axis."""
    for motion in _motions(case):
        points, count = numbered(np.isnan(motion.rows[1 : len(case.trajectory) + 1]).any(axis=1))
        if count:
            sentence = f"{case.limits.whose} does not reach {counted(count, 'set point')}"
            yield Finding("reach", Severity.ERROR, sentence, "check the positions", points, count)
            continue
        for place in range(len(motion.axes)):
            yield from _bounds(case, motion, place)
    yield from _turning(case)
    names = [axis.name for axis in case.trajectory.axes if axis.unit]
    if not any(map(case.limits.knows, names)) and case.limits.to_joints is None:
        sentence = "no limits of this arm are known, so that speeds are told but compared with nothing"
        yield Finding("limits", Severity.NOTE, sentence, "give limits, such as J1=-170..170 or J1.speed=300")


def rest(case: Case) -> Iterator[Finding]:
    """Look for a start or an end at speed."""
    motion = _own(case)
    speeds = np.abs(motion.speeds)
    if not len(speeds) or case.step is None:
        return
    floor = np.maximum(_SLOW * speeds.max(axis=0), _CRAWL)
    for verb, row, number in (("begins", 0, 1), ("ends", -1, len(case.trajectory))):
        place = int(np.argmax(speeds[row] / floor))
        if speeds[row, place] > floor[place]:
            axis = motion.axes[place]
            sentence = (
                f"the trajectory {verb} at speed: {axis.name} at {speeds[row, place]:.4g} {axis.unit}/s"
            )
            yield Finding("rest", Severity.WARNING, sentence, RESAMPLE, (number,), 1)
            if case.loop:
                return  # at speed from round to round


def first_point(case: Case) -> Iterator[Finding]:
    """Compare the first point with where the robot is."""
    away = distance(case)
    if away is None or case.present is None:
        return
    kind, axes, first = case.trajectory.kind, case.trajectory.axes, case.trajectory.points[0]
    far = [place for place, axis in enumerate(axes) if axis.unit and abs(away[place]) > NEAR]
    named = [_away(axes[place], away[place]) for place in far]
    width = min(len(case.present), len(axes))
    turned = float(turns(kind, np.vstack((np.asarray(case.present[:width]), first[:width])))[0])
    if turned > NEAR:
        named.append(_away(_DIRECTIONS, turned))
    if named:
        sentence = f"the first point is away from where the robot is: {', '.join(named)}"
        yield Finding("first-point", Severity.WARNING, sentence, _MOVE, (1,), 1)
    if not has_posture(kind, case.present, first.tolist()):
        fig = FIG[kind]
        sentence = f"the first point has Fig {first[fig]:g}, the robot has {case.present[fig]:g} now"
        yield Finding("first-point", Severity.WARNING, sentence, _MOVE, (1,), 1)


def distance(case: Case) -> tuple[float, ...] | None:
    """Return how far the first point is from where the robot is, an element an axis of the trajectory.

    Rotations of P type count the shorter way round. None where it is not known.
    """
    if case.present is None:
        return None
    width = min(len(case.present), len(case.trajectory.axes))
    first = case.trajectory.points[0, :width]
    both = unwound(case.trajectory.kind, np.vstack((np.asarray(case.present[:width]), first)))
    missing = (0.0,) * (len(case.trajectory.axes) - width)
    return (*(both[1] - both[0]).tolist(), *missing)


def join(case: Case) -> Iterator[Finding]:
    """Compare the last point with the first where it starts again."""
    if not case.loop or len(case.trajectory) < 2 or case.step is None:
        return
    motion = _own(case)
    last, first = next(_of(case, case.trajectory.points[[-1, 0]])).rows
    back = first - last
    most = np.maximum(np.abs(np.diff(motion.rows, axis=0)).max(axis=0), NEAR)
    far = [place for place in range(len(motion.axes)) if abs(back[place]) > most[place]]
    if far:
        named = ", ".join(_away(motion.axes[place], back[place]) for place in far)
        sentence = f"the last point is away from the first, to which it returns in one step: {named}"
        advice = "end where it begins, or play it once"
        yield Finding("loop", Severity.ERROR, sentence, advice, (len(case.trajectory), 1), 2)


def still(case: Case) -> Iterator[Finding]:
    """Tell where nothing moves."""
    if not np.ptp(case.trajectory.points, axis=0).any():
        count = counted(len(case.trajectory), "set point")
        yield Finding("still", Severity.NOTE, f"nothing moves: {count}, all the same")


def _own(case: Case) -> Motion:
    """Return the motion of the trajectory's own axes."""
    return next(_of(case, case.trajectory.points))


def _motions(case: Case) -> Iterator[Motion]:
    """Return the motion of each set of axes, longer at both ends: by rest, or as the next round begins."""
    points = case.trajectory.points
    after = points[:2] if case.loop else points[-1:]
    return _of(case, np.vstack((points[:1], points, after)))


def _of(case: Case, points: Array) -> Iterator[Motion]:
    return motions(case.trajectory.kind, points, case.step or case.period, case.limits)


def _figures(case: Case, motion: Motion, place: int) -> Figures:
    axis, column = motion.axes[place], motion.rows[:, place]
    speeds = np.abs(motion.speeds[:, place])
    fastest = int(np.argmax(speeds))
    return Figures(
        axis=axis,
        low=float(column.min()),
        high=float(column.max()),
        step=float(speeds[fastest]) * motion.period,
        speed=float(speeds[fastest]),
        acceleration=float(np.abs(motion.accelerations[:, place]).max()),
        fastest=fastest % len(case.trajectory) + 1,
        limit=case.limits.told(axis.name),
    )


def _bounds(case: Case, motion: Motion, place: int) -> Iterator[Finding]:
    axis, count = motion.axes[place], len(case.trajectory)
    limit, unit = case.limits.of(axis.name, axis.unit), axis.unit
    values = motion.rows[1 : count + 1, place]
    outside = (values < limit.low) | (values > limit.high)
    yield from _beyond(
        "range",
        outside,
        f"{axis.name} goes from {values.min():.6g} to {values.max():.6g} {unit}, "
        f"its limits are {limit.low:g} and {limit.high:g}",
        "check the positions",
    )
    if case.step is None:
        return
    speeds = np.abs(motion.speeds[:, place])
    whose = f"its limit is {limit.speed:g}" if limit.speed != FASTEST.get(unit) else _TOO_FAST
    yield from _beyond(
        "speed",
        _at_points(speeds > limit.speed * _SLACK, count),
        f"{axis.name} reaches {speeds.max():.4g} {unit}/s, {whose}",
        _SLOWER,
    )
    accelerations = np.abs(motion.accelerations[:, place])
    yield from _beyond(
        "acceleration",
        _at_points(accelerations > limit.acceleration * _SLACK, count),
        f"{axis.name} accelerates by {accelerations.max():.4g} {unit}/s², "
        f"its limit is {limit.acceleration:g}",
        f"play it more slowly, or {RESAMPLE}",
    )


def _turning(case: Case) -> Iterator[Finding]:
    """Look at how fast the directions of T type turn."""
    if case.step is None:
        return
    points, most = case.trajectory.points, FASTEST[_DIRECTIONS.unit]
    after = points[:1] if case.loop else points[-1:]
    speeds = turns(case.trajectory.kind, np.vstack((points[:1], points, after))) / case.step
    told = f"{_DIRECTIONS.name} reaches {speeds.max():.4g} {_DIRECTIONS.unit}/s, {_TOO_FAST}"
    yield from _beyond("speed", _at_points(speeds > most, len(points)), told, _SLOWER)


def _at_points(where: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Give what is found to its set point; behind the last one come those of the next round."""
    at = where[:count].copy()
    rest = where[count : 2 * count]
    at[: len(rest)] |= rest
    return at


def _beyond(check: str, where: NDArray[np.bool_], sentence: str, advice: str) -> Iterator[Finding]:
    points, count = numbered(where)
    if count:
        told = f"{sentence}: {counted(count, 'set point')}"
        yield Finding(check, Severity.ERROR, told, advice, points, count)


def _away(axis: Axis, way: float) -> str:
    return f"{axis.name} {way:+.4g} {axis.unit}"
