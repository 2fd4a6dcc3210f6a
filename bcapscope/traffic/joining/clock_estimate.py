"""Estimate the difference between the clocks at two places, from the frames that both places captured.

The clock offset is the time by which the controller-side clock is ahead of the client-side clock. Each
request gives an upper bound for the offset, because a request cannot arrive before the client sent it. Each
reply gives a lower bound. The estimated offset is between the lowest upper and the highest lower bound.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple

SEGMENT_NS = 10_000_000_000
"""Length in ns of a time segment. In this time, clocks drift apart by less than 2 ms even at 200 ppm."""

MAX_DRIFT = 200e-6
"""Maximum drift between two clocks, as a ratio. The quartz of a PC is off by at most 100 ppm."""

_STEPS = 60
"""Number of steps of a numerical search; each narrows the searched range by at least a third."""

UNKNOWN_ERROR_NS = 1_000_000_000
"""Assumed uncertainty in ns of the clock offset if no time segment has both requests and replies."""


class ClockEstimate(NamedTuple):
    """Estimate of the time by which the controller-side clock is ahead of the client-side clock.

    Attributes:
        points: Pairs of a time, in ns since 1970 by the controller-side clock, and the offset at this time in
            ns. Between and beyond the points, the offset changes linearly.
        error: Uncertainty of the offset, ns: half the distance between its bounds.
        drift: How much faster the controller-side clock runs, as a ratio: 1e-6 is a lead of one microsecond
            per second. None if unknown.
    """

    points: tuple[tuple[int, int], ...]
    error: int
    drift: float | None = None

    def offset_at(self, time: int) -> int:
        """Return the offset in ns at a time of the controller-side clock."""
        points = self.points
        if len(points) == 1:
            return points[0][1]
        after = min(max(bisect_right(points, (time,)), 1), len(points) - 1)
        (began, first), (ended, last) = points[after - 1], points[after]
        return first + (last - first) * (time - began) // (ended - began)

    def to_client_clock(self, time: int) -> int:
        """Convert a time of the controller-side clock to the time of the client-side clock, ns since 1970."""
        return time - self.offset_at(time)


class ClockEstimator:
    """Collects the times of frames that two places captured. Add the frames in order of time."""

    def __init__(self) -> None:
        self._most = _UpperBound()
        self._least = _UpperBound()  # of the negative offset

    def add_frame(self, at_client: int, at_controller: int, *, is_request: bool) -> None:
        """Add a frame that both places captured. `at_client` is the time by the client-side clock, and
        `at_controller` is the time by the controller-side clock, in ns since 1970.
        """
        if is_request:
            self._most.add(at_controller, at_controller - at_client)
        else:
            self._least.add(at_controller, at_client - at_controller)

    def estimate(self) -> ClockEstimate | None:
        most, least = self._most.corners, self._least.corners
        if not most and not least:
            return None
        if not most or not least:
            time, ahead = min(most or least, key=lambda corner: corner[1])
            return ClockEstimate(((time, ahead if most else -ahead),), UNKNOWN_ERROR_NS)
        return _OffsetBounds(most, least).straight_line() or self._curve()

    def _curve(self) -> ClockEstimate:
        """Return an estimate for a drift that changes: the middle between the bounds in each time segment."""
        most, least = self._most.lowest, self._least.lowest
        segments = sorted(most.keys() & least.keys())
        if not segments:
            return ClockEstimate((self._most.corners[0],), UNKNOWN_ERROR_NS)
        points, errors = [], []
        for segment in segments:
            (ahead, time), (behind, other_time) = most[segment], least[segment]
            points.append(((time + other_time) // 2, (ahead - behind) // 2))
            errors.append((abs(ahead + behind) + 1) // 2)
        return ClockEstimate(tuple(points), max(errors))


class _UpperBound:
    """An upper bound for the offset between two clocks. Call `add` in order of time.

    Attributes:
        corners: Corners of the lower convex hull of the values: pairs of time and value.
        lowest: For each time segment, its lowest value and the time of this value.
    """

    def __init__(self) -> None:
        self.corners: list[tuple[int, int]] = []
        self.lowest: dict[int, tuple[int, int]] = {}

    def add(self, time: int, value: int) -> None:
        segment = time // SEGMENT_NS
        self.lowest[segment] = min(self.lowest.get(segment, (value, time)), (value, time))
        corners = self.corners
        if corners and time <= corners[-1][0]:
            if time < corners[-1][0]:
                return
            value = min(value, corners.pop()[1])
        while len(corners) > 1:
            (first, low), (second, middle) = corners[-2:]
            if (second - first) * (value - low) > (middle - low) * (time - first):
                break
            corners.pop()
        corners.append((time, value))


class _OffsetBounds:
    """Bounds for the clock offset. Private methods count times from `_began` and offsets from `_offset`."""

    def __init__(self, most: Sequence[tuple[int, int]], least: Sequence[tuple[int, int]]) -> None:
        times = [time for time, _ in (*most, *least)]
        self._began, self._ended = min(times), max(times)
        self._offset = min(ahead for _, ahead in most)
        self._most = [(float(time - self._began), float(ahead - self._offset)) for time, ahead in most]
        self._least = [(float(time - self._began), float(-ahead - self._offset)) for time, ahead in least]

    def straight_line(self) -> ClockEstimate | None:
        """Estimate an offset that changes linearly with time; None if no such offset is within the bounds."""
        best = _highest(self._width, -MAX_DRIFT, MAX_DRIFT)
        if self._width(best) < 0:
            return None
        slowest = _last_sound(self._width, best, -MAX_DRIFT)
        fastest = _last_sound(self._width, best, MAX_DRIFT)
        points, errors = [], []
        for time in dict.fromkeys((self._began, self._ended)):
            most, least = self._limits_at(time - self._began, slowest, fastest)
            points.append((time, self._offset + round((most + least) / 2)))
            errors.append((most - least) / 2)
        drift = (slowest + fastest) / 2 if slowest * fastest > 0 else None
        return ClockEstimate(tuple(points), round(max(errors)) + 1, drift)

    def _limits_at(self, time: int, slowest: float, fastest: float) -> tuple[float, float]:
        """Return the highest and the lowest possible offset at `time` if the offset changes linearly."""

        def top(drift: float) -> float:
            return self._top(drift) + drift * time

        def depth(drift: float) -> float:
            return -self._bottom(drift) - drift * time

        return top(_highest(top, slowest, fastest)), -depth(_highest(depth, slowest, fastest))

    def _top(self, drift: float) -> float:
        return min(ahead - drift * at for at, ahead in self._most)

    def _bottom(self, drift: float) -> float:
        return max(ahead - drift * at for at, ahead in self._least)

    def _width(self, drift: float) -> float:
        return self._top(drift) - self._bottom(drift)


def _highest(value: Callable[[float], float], low: float, high: float) -> float:
    """Return the number between `low` and `high` at which the concave function `value` is highest."""
    for _ in range(_STEPS):
        third = (high - low) / 3
        if value(low + third) < value(high - third):
            low += third
        else:
            high -= third
    return (low + high) / 2


def _last_sound(value: Callable[[float], float], sound: float, bound: float) -> float:
    """Return the number nearest to `bound` at which the concave function `value` is not negative. The
    search begins at `sound`, where `value` is not negative.
    """
    for _ in range(_STEPS):
        middle = (sound + bound) / 2
        if value(middle) >= 0:
            sound = middle
        else:
            bound = middle
    return sound
