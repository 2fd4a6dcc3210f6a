"""Estimate how the clock at one place differs from the clock at another, from the frames that both captured.

A frame cannot arrive before it was sent. A request therefore shows how far the controller's clock is ahead at
most, and a reply how far it is ahead at least. The truth lies between the closest request and the closest
reply.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

SEGMENT_NS = 10_000_000_000
"""Length of a segment in ns. Over this time, clocks drift apart by less than 2 ms even at 200 ppm."""

UNKNOWN_ERROR_NS = 1_000_000_000
"""Uncertainty in ns if the traffic bounds the offset from one side only."""


class ClockEstimate(NamedTuple):
    """How far the controller-side clock is ahead of the client-side clock.

    Attributes:
        points: Times by the controller-side clock, ns since 1970, each with the offset at that time, ns.
            Between the points, and beyond them, the offset follows a straight line.
        error: Uncertainty of the offset, ns: half the distance between its bounds.
    """

    points: tuple[tuple[int, int], ...]
    error: int

    def offset_at(self, time: int) -> int:
        """Return the offset in ns at a time by the controller-side clock."""
        points = self.points
        if len(points) == 1:
            return points[0][1]
        after = min(max(bisect_right(points, (time,)), 1), len(points) - 1)
        (began, first), (ended, last) = points[after - 1], points[after]
        return first + (last - first) * (time - began) // (ended - began)

    def to_client_clock(self, time: int) -> int:
        """Convert a time by the controller-side clock to the client-side clock, ns since 1970."""
        return time - self.offset_at(time)

    @property
    def drift(self) -> float:
        """How much faster the controller-side clock runs, as a ratio: 1e-6 is one microsecond per second."""
        (began, first), (ended, last) = self.points[0], self.points[-1]
        return (last - first) / (ended - began) if ended > began else 0.0


class _Segment:
    """Bounds of the offset in one segment of time, each with its time."""

    def __init__(self) -> None:
        self.most: tuple[int, int] | None = None
        self.least: tuple[int, int] | None = None

    @property
    def middle(self) -> tuple[int, int] | None:
        """Middle of the bounds, with its time; None if a bound is unknown."""
        if self.most is None or self.least is None:
            return None
        return (self.most[1] + self.least[1]) // 2, (self.most[0] + self.least[0]) // 2


class ClockEstimator:
    """Collects the times of frames that two places captured."""

    def __init__(self) -> None:
        self._segments: dict[int, _Segment] = {}

    def add_frame(self, at_client: int, at_controller: int, *, is_request: bool) -> None:
        """Add a frame with its time at each place, each by the clock of that place, ns since 1970."""
        ahead = at_controller - at_client
        segment = self._segments.setdefault(at_controller // SEGMENT_NS, _Segment())
        if is_request:
            if segment.most is None or ahead < segment.most[0]:
                segment.most = ahead, at_controller
        elif segment.least is None or ahead > segment.least[0]:
            segment.least = ahead, at_controller

    def estimate(self) -> ClockEstimate | None:
        """Return the estimate; None without any frame."""
        segments = [segment for _, segment in sorted(self._segments.items())]
        if not segments:
            return None
        middles = [middle for segment in segments if (middle := segment.middle) is not None]
        if not middles:
            bounds = [each for segment in segments for each in (segment.most, segment.least) if each]
            closest = min(bounds, key=lambda bound: abs(bound[0] - median(each[0] for each in bounds)))
            return ClockEstimate(((closest[1], closest[0]),), UNKNOWN_ERROR_NS)
        straight = _straight_line(segments, middles)
        return straight or _curve(segments, middles)


def _straight_line(segments: Sequence[_Segment], middles: Sequence[tuple[int, int]]) -> ClockEstimate | None:
    """Return a constant drift that contradicts no frame; None if there is none."""
    slope = _slope(middles)
    origin, offset = middles[0]

    def rest(bound: tuple[int, int]) -> int:
        return bound[0] - offset - round(slope * (bound[1] - origin))

    most = min(rest(segment.most) for segment in segments if segment.most is not None)
    least = max(rest(segment.least) for segment in segments if segment.least is not None)
    if most < least:
        return None
    level = offset + (most + least) // 2
    ended = middles[-1][0]
    points = [(origin, level)]
    if ended > origin:
        points.append((ended, level + round(slope * (ended - origin))))
    return ClockEstimate(tuple(points), (most - least + 1) // 2)


def _curve(segments: Sequence[_Segment], middles: Sequence[tuple[int, int]]) -> ClockEstimate:
    """Return the middle of the bounds of each segment, for clocks whose drift changes."""
    widths = [
        segment.most[0] - segment.least[0]
        for segment in segments
        if segment.most is not None and segment.least is not None
    ]
    points = dict(middles)  # each time once
    return ClockEstimate(tuple(sorted(points.items())), (max(map(abs, widths)) + 1) // 2)


def _slope(middles: Sequence[tuple[int, int]]) -> float:
    """Return the slope of the straight line through the middles with the smallest squared errors."""
    origin, offset = middles[0]
    times = [time - origin for time, _ in middles]
    offsets = [each - offset for _, each in middles]
    count = len(middles)
    mean_time, mean_offset = sum(times) / count, sum(offsets) / count
    spread = sum((time - mean_time) ** 2 for time in times)
    if not spread:
        return 0.0
    return sum((t - mean_time) * (o - mean_offset) for t, o in zip(times, offsets, strict=True)) / spread
