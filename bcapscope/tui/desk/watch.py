"""Variables that are read again and again: the latest value, its rate of change, extremes, recent course."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from bcapscope.protocol.variant import ARRAY, VT, Variant
from bcapscope.render.sparkline import sparkline

REMEMBERED = 120
"""Readings that the course shows at most."""

_SECOND = 1_000_000_000
_BROKEN = frozenset({VT.R4, VT.R8, VT.DATE})


@dataclass(slots=True)
class Series:
    """One number of a variable over time: the variable itself, or an element of an array.

    Attributes:
        least: since the beginning, or since `reset`.
        most: likewise.
    """

    points: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    least: float | None = None
    most: float | None = None

    def add(self, time: int, value: float) -> None:
        """Take a reading; times are ns of one clock."""
        self.points.append((time, value))
        self.least = value if self.least is None else min(self.least, value)
        self.most = value if self.most is None else max(self.most, value)

    @property
    def last(self) -> float | None:
        """The newest reading."""
        return self.points[-1][1] if self.points else None

    @property
    def rate(self) -> float | None:
        """Change a second between the last two readings; None where there are not two."""
        if len(self.points) < 2:
            return None
        (before, was), (now, value) = self.points[-2], self.points[-1]
        return (value - was) * _SECOND / (now - before) if now > before else None

    def course(self, width: int) -> str:
        """Draw the last readings, one character each."""
        return sparkline([value for _, value in self.points][-width:])


@dataclass(slots=True)
class Watched:
    """A variable that is watched.

    Attributes:
        label: as the user knows it, such as `Gundam.@CURRENT_ANGLE`.
        handle: of the variable.
        value: read last; None before the first time.
        trouble: why it could not be read the last time; else empty.
        series: a `Series` for each number in it; empty for text.
    """

    label: str
    handle: int
    value: Variant | None = None
    trouble: str = ""
    series: list[Series] = field(default_factory=list)

    @property
    def decimals(self) -> int:
        """Places behind the point of its numbers, five as b-CAP Tester has them; none of whole ones."""
        return 5 if self.value is not None and self.value.vt & ~ARRAY in _BROKEN else 0

    def take(self, value: Variant, time: int) -> None:
        """Take a reading."""
        self.value, self.trouble = value, ""
        numbers = _numbers(value)
        if len(numbers) != len(self.series):
            self.series = [Series() for _ in numbers]
        for series, number in zip(self.series, numbers, strict=True):
            series.add(time, number)

    def fail(self, reason: str) -> None:
        """Take notice that it could not be read."""
        self.trouble = reason

    def reset(self) -> None:
        """Forget extremes and course."""
        self.series = [Series() for _ in self.series]


def _numbers(variant: Variant) -> list[float]:
    value = variant.value
    if isinstance(value, bool | int | float):
        return [float(value)]
    if isinstance(value, bytes):
        return []
    if isinstance(value, tuple) and all(isinstance(each, bool | int | float) for each in value):
        return [float(each) for each in value if isinstance(each, bool | int | float)]
    return []
