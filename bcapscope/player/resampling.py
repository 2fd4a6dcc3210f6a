"""Change the timing of a robot's motion along a path, or bring the robot to rest at any point.

The path is a `SmoothCurve` through the set points; only the speed along the path changes. The speed grows
from 0 as the polynomial 10u³ - 15u⁴ + 6u⁵, and falls to 0 along the mirrored curve. The first and second
derivatives of this polynomial are 0 at u = 0 and u = 1. Position, speed and acceleration are therefore
continuous.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import ceil, inf

import numpy as np

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Measured
from bcapscope.player.arm_limits import UNKNOWN_ARM, ArmLimits, limit_excess
from bcapscope.player.smooth_curve import Array, SmoothCurve
from bcapscope.player.trajectory import MAX_POINTS, Trajectory, TrajectoryError, find_gaps

DEFAULT_RAMP = 0.25
"""Seconds that a start or a stop takes by default."""

_SHORTEST_STOP, _LONGEST_STOP = 0.1, 2.0  # minimum and maximum braking time in seconds
_STOP_GROWTH = 1.5  # if a braking time is too short, `stop_after` multiplies the time by this factor
_DEFAULT_STOP = 0.5  # minimum braking time in seconds if an acceleration limit is unknown
_ROUNDING = 1e-9  # tolerance for rounding errors in a computed number of cycles


def resample(
    trajectory: Trajectory, period: float, *, speed: float = 1.0, ramp: float = DEFAULT_RAMP
) -> Trajectory:
    """Return a trajectory along the same path, with one set point every `period` seconds. The first and the
    last point stay the same.

    If `trajectory` has times but no period, the times must increase. If `trajectory` has neither times nor a
    period, `period` becomes its period.

    Args:
        period: Seconds between the set points of the result.
        speed: Maximum speed of the result, as a share of the original speed; above 0.
        ramp: Duration of the start and of the stop in seconds; 0 if the trajectory begins and ends at rest.

    Raises TrajectoryError if a number is not finite, times do not increase, or the result has too many set
    points. Raises InputError if period, speed or ramp is invalid.
    """
    if not (0 < period < inf and 0 < speed < inf and 0 <= ramp < inf):
        raise InputError(
            Message("resample.invalid", period=f"{period:g}", speed=f"{speed:g}", ramp=f"{ramp:g}")
        )
    bad = np.flatnonzero(~np.isfinite(trajectory.points).all(axis=1))
    if len(bad):
        raise TrajectoryError(Message("trajectory.not-finite", number=int(bad[0]) + 1))
    knots = _knots(trajectory, period)
    with np.errstate(all="ignore"):
        parameters = _curve_parameters(float(knots[-1]), period, speed, ramp)
        if len(trajectory) == 1:
            return replace(trajectory, points=trajectory.points.copy(), period=period, times=None)
        points = SmoothCurve(trajectory.kind, knots, trajectory.points).sample(parameters)
    points[0], points[-1] = trajectory.points[0], trajectory.points[-1]
    source = replace(
        trajectory.source,
        notes=(*trajectory.source.notes, *_resampling_notes(trajectory, period, speed, ramp)),
    )
    return Trajectory(trajectory.kind, points, source, period)


def _resampling_notes(trajectory: Trajectory, period: float, speed: float, ramp: float) -> Iterator[Message]:
    if trajectory.period is None and trajectory.times is None:
        yield Message("trajectory.note.assumed-interval", period=f"{period * 1000:.6g}")
    yield Message(
        "trajectory.note.resampled", period=f"{period * 1000:g}", speed=f"{speed:.3g}", ramp=f"{ramp:.3g}"
    )
    if trajectory.period is None and trajectory.times is not None:
        count = int(find_gaps(trajectory.times).sum())
        if count:
            longest = float(np.diff(trajectory.times).max()) * 1000
            yield Message("trajectory.note.gap", gaps=Count(count, "gap"), longest=Measured(longest, "ms"))


def stop_after(
    trajectory: Trajectory, row: int, period: float, limits: ArmLimits = UNKNOWN_ARM, *, loop: bool = False
) -> Array:
    """Return the set points, one per row, that bring the robot from set point `row` to rest on the path.

    The braking time is between 0.1 s (0.5 s if an acceleration limit is unknown) and 2 s. The function
    increases the braking time until the set points keep within `limits`. If the trajectory near `row` exceeds
    a limit, the returned set points may exceed limits by the same factor. If the remaining path is too short
    to come to rest, return the remaining points. `period` is in seconds. With `loop`, the first point follows
    the last point.
    """
    ahead = 2 * len(trajectory) if loop else len(trajectory) - 1 - row
    longest = min(ceil(_LONGEST_STOP / period), 2 * ahead)
    window = np.arange(row - 2, row + 2 + (longest + 1) // 2)
    places = window % len(trajectory) if loop else np.clip(window, 0, len(trajectory) - 1)
    near = trajectory.points[places]
    widths = zip(trajectory.axes, np.ptp(near, axis=0), strict=True)
    turning = [axis for axis, width in widths if width > 0 and axis.unit]
    bounded = all(limits.limit_for(axis.name, axis.unit).acceleration < inf for axis in turning)
    cycles = max(ceil((_SHORTEST_STOP if bounded else _DEFAULT_STOP) / period), 2)
    if longest < cycles:
        return trajectory.points[row + 1 :]
    curve = SmoothCurve(trajectory.kind, np.arange(len(near), dtype=np.float64), near)
    allowed = max(1.0, limit_excess(trajectory.kind, near, period, limits))
    while True:
        part = np.linspace(1 / cycles, 1, cycles)
        points = curve.sample(2 + cycles * (part - _ramp_integral(part)))
        whole = np.vstack((near[:3], points, points[-1:]))
        if cycles == longest or limit_excess(trajectory.kind, whole, period, limits) <= allowed:
            return points
        cycles = min(ceil(cycles * _STOP_GROWTH), longest)


def _curve_parameters(end: float, period: float, speed: float, ramp: float) -> Array:
    """For each cycle, return the position on the path, expressed as a time in the original trajectory in
    seconds. This time grows from 0 to `end`.
    """
    time = end / speed
    if not time / period < MAX_POINTS - ramp / period - 2:
        raise TrajectoryError(Message("resample.too-long", time=f"{time:.3g}", period=f"{period:.3g}"))
    cycles = ceil((max(time, ramp) + ramp) / period - _ROUNDING) if end else 0
    times = np.arange(cycles + 1, dtype=np.float64) * period
    total = float(times[-1])
    rate = end / (total - ramp) if end else 0.0
    if not ramp:
        return np.asarray(rate * times)
    begun = _ramp_integral(np.minimum(times / ramp, 1.0)) + np.maximum(times / ramp - 1.0, 0.0)
    ending = np.minimum((total - times) / ramp, 1.0)
    lost = 0.5 - ending + _ramp_integral(ending)
    return np.asarray(rate * ramp * (begun - lost))


def _knots(trajectory: Trajectory, period: float) -> Array:
    if trajectory.period is not None or trajectory.times is None:
        return np.arange(len(trajectory), dtype=np.float64) * (trajectory.period or period)
    with np.errstate(all="ignore"):
        knots: Array = trajectory.times - trajectory.times[0]
        bad = np.flatnonzero(~(np.diff(knots) > 0) | ~np.isfinite(knots[1:]))
    if len(bad):
        raise TrajectoryError(Message("trajectory.time-order", number=int(bad[0]) + 2))
    return knots


def _ramp_integral(part: Array) -> Array:
    """Return the distance from the start of a ramp, after the share `part` (0 to 1) of the ramp's duration.

    The distance is relative: 1 is the distance that the robot covers at full speed in the duration of a ramp.
    The whole ramp covers a distance of 0.5.
    """
    gained: Array = part**4 * (2.5 - part * (3.0 - part))
    return gained
