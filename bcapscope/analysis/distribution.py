"""How values are spread: percentiles and a histogram, in memory that does not grow with their number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = "NDArray[np.float64]"
Bools: TypeAlias = "NDArray[np.bool_]"

EXACT = 4096
"""So many values are kept as they are; from then on they are counted in bins."""

_PER_OCTAVE = 128
"""Bins between a power of two and the next: the middle of a bin is less than 0.4% from all in it."""

_LOWEST, _HIGHEST = -24, 40
"""Powers of two between which bins are told apart: from a micrometre's tenth in mm to decades in ms."""

_BINS = (_HIGHEST - _LOWEST) * _PER_OCTAVE


@dataclass(frozen=True, slots=True)
class Bin:
    """How many values there are from `low`, itself included, to `high`."""

    low: float
    high: float
    count: int


@dataclass(frozen=True, slots=True)
class Distribution:
    """How values are spread. A percentile is the smallest value that this share of all does not exceed.

    Attributes:
        count: of values.
        mean: of them, exact.
        least: exact.
        most: exact.
        p50: exact for up to 4096 values, else within 0.4%, as all percentiles.
        p90: likewise.
        p99: likewise.
        p999: likewise.
        bins: in order, without empty ones, 128 to a power of two; () where nobody wants to draw them.
    """

    count: int
    mean: float
    least: float
    most: float
    p50: float
    p90: float
    p99: float
    p999: float
    bins: tuple[Bin, ...] = ()

    def scaled(self, factor: float) -> Distribution:
        """Return that of the same values in another unit, without bins."""
        points = (self.mean, self.least, self.most, self.p50, self.p90, self.p99, self.p999)
        mean, least, most, p50, p90, p99, p999 = (point * factor for point in points)
        return Distribution(self.count, mean, least, most, p50, p90, p99, p999)


class Histogram:
    """Takes values, 0 or more, and tells how they are spread; what is negative or no number is left out."""

    __slots__ = ("_counts", "_few", "count", "least", "most", "total")

    def __init__(self) -> None:
        self.count = 0
        self.total = 0.0
        self.least = math.inf
        self.most = 0.0
        self._few: list[Floats] = []
        self._counts: NDArray[np.int64] | None = None

    def add(self, values: Floats) -> None:
        """Take values in."""
        if not len(values):
            return
        least, most = values.min(), values.max()
        if not (least >= 0 and most < math.inf):  # NaN makes this false as well
            self.add(values[(values >= 0) & (values < math.inf)])
            return
        self.count += len(values)
        self.total += float(values.sum())
        self.least, self.most = min(self.least, float(least)), max(self.most, float(most))
        if self._counts is not None:
            self._counts += np.bincount(_bin_numbers(values), minlength=_BINS)
            return
        self._few.append(values)
        if self.count > EXACT:
            self._counts = np.bincount(_bin_numbers(np.concatenate(self._few)), minlength=_BINS)
            self._few = []
        elif len(self._few) > _MOST_PIECES:
            self._few = [np.concatenate(self._few)]

    def merge(self, other: Histogram) -> None:
        """Take in all that another histogram took."""
        if other._counts is None:
            for values in other._few:
                self.add(values)
            return
        if self._counts is None:
            few, self._few = self._few, []
            self._counts = np.bincount(_bin_numbers(np.concatenate(few)) if few else [], minlength=_BINS)
        self._counts = self._counts + other._counts
        self.count += other.count
        self.total += other.total
        self.least, self.most = min(self.least, other.least), max(self.most, other.most)

    def distribution(self, bins: bool = False) -> Distribution | None:
        """Tell how the values so far are spread; None where there is none."""
        if not self.count:
            return None
        if self._counts is None:
            values = np.sort(np.concatenate(self._few))
            points = [float(values[_rank(share, len(values)) - 1]) for share in _SHARES]
            counts = np.bincount(_bin_numbers(values)) if bins else None
        else:
            counts, points = self._counts, self._percentiles(self._counts)
        drawn = _bins(counts) if bins and counts is not None else ()
        mean = min(max(self.total / self.count, self.least), self.most)
        p50, p90, p99, p999 = points
        return Distribution(self.count, mean, self.least, self.most, p50, p90, p99, p999, drawn)

    def _percentiles(self, counts: NDArray[np.int64]) -> list[float]:
        ranks = [_rank(share, self.count) for share in _SHARES]
        found = np.searchsorted(np.cumsum(counts), ranks)
        middles = [(_edge(number) + _edge(number + 1)) / 2 for number in found.tolist()]
        return [min(max(middle, self.least), self.most) for middle in middles]


_SHARES = (500, 900, 990, 999)  # thousandths
_MOST_PIECES = 64


def _rank(share: int, count: int) -> int:
    return -(-share * count // 1000)


def _bin_numbers(values: Floats) -> NDArray[np.int64]:
    mantissas, exponents = np.frexp(values)
    parts = ((mantissas - 0.5) * (2 * _PER_OCTAVE)).astype(np.int64)
    numbers = (exponents - (_LOWEST + 1)) * _PER_OCTAVE + parts
    return np.clip(np.where(values > 0, numbers, 0), 0, _BINS - 1)


def _edge(number: int) -> float:
    """Return the lower edge of a bin; that of the first is 0."""
    if number <= 0:
        return 0.0
    octave, part = divmod(number, _PER_OCTAVE)
    return math.ldexp(1 + part / _PER_OCTAVE, octave + _LOWEST)


def _bins(counts: NDArray[np.int64]) -> tuple[Bin, ...]:
    filled = np.flatnonzero(counts).tolist()
    return tuple(Bin(_edge(number), _edge(number + 1), int(counts[number])) for number in filled)
