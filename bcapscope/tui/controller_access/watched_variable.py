"""A watched variable: latest value, rate of change, extremes and recent readings."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.render.sparkline import sparkline

MAX_READINGS = 120
"""Readings in the sparkline."""

_SECOND = 1_000_000_000
_FRACTIONAL_TYPES = frozenset({VT.R4, VT.R8, VT.DATE})


@dataclass(slots=True)
class WatchSeries:
    """Readings of one number over time: of a variable, or of one element of an array."""

    readings: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=MAX_READINGS))
    minimum: float | None = None
    maximum: float | None = None

    def add(self, time: int, value: float) -> None:
        """Add a reading; `time` is ns of one clock for all readings."""
        self.readings.append((time, value))
        self.minimum = value if self.minimum is None else min(self.minimum, value)
        self.maximum = value if self.maximum is None else max(self.maximum, value)

    @property
    def last(self) -> float | None:
        return self.readings[-1][1] if self.readings else None

    @property
    def rate(self) -> float | None:
        """Change of the number per second between the last two readings; None before the second reading."""
        if len(self.readings) < 2:
            return None
        (before, was), (now, value) = self.readings[-2], self.readings[-1]
        return (value - was) * _SECOND / (now - before) if now > before else None

    def sparkline_text(self, width: int) -> str:
        return sparkline([value for _, value in self.readings][-width:])


@dataclass(slots=True)
class WatchedVariable:
    """A watched variable.

    Attributes:
        label: Name of the variable for the user, such as `Gundam.@CURRENT_ANGLE`.
        problem: Reason why the last reading failed; empty if it succeeded.
        series: A `WatchSeries` for each number in the variable's value; empty for text.
    """

    label: str
    handle: int
    value: Variant | None = None
    problem: str = ""
    series: list[WatchSeries] = field(default_factory=list)

    @property
    def decimals(self) -> int:
        """Number of decimal places: five, as in b-CAP Tester, or none for integers."""
        return 5 if self.value is not None and self.value.vt & ~ARRAY in _FRACTIONAL_TYPES else 0

    def add_reading(self, value: Variant, time: int) -> None:
        """Add a reading that was taken at `time` (ns)."""
        self.value, self.problem = value, ""
        numbers = _numbers(value)
        if len(numbers) != len(self.series):
            self.series = [WatchSeries() for _ in numbers]
        for series, number in zip(self.series, numbers, strict=True):
            series.add(time, number)

    def reset_extremes(self) -> None:
        self.series = [WatchSeries() for _ in self.series]


def _numbers(variant: Variant) -> list[float]:
    """Return the numbers in a value, for an array one per element; () if any element is not a number."""
    values = variant.value if isinstance(variant.value, tuple) else (variant.value,)
    numbers = [float(each) for each in values if isinstance(each, bool | int | float)]
    return numbers if len(numbers) == len(values) else []
