"""Distribution of values: percentiles and a histogram, in bounded memory."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.statistics.distribution_summary import Bin, DistributionSummary

Floats: TypeAlias = "NDArray[np.float64]"
Bools: TypeAlias = "NDArray[np.bool_]"

EXACT_UP_TO = 8192
"""A histogram with more values than this counts the values in bins, and so is less exact."""

_PER_OCTAVE = 128
"""Number of bins per power of two: each value differs from the middle of its bin by less than 0.4 %."""

_LOWEST, _HIGHEST = -24, 40
"""Exponents (base 2) of the limits of the bins. For values in ms, the limits are 0.06 ns and 35 years."""

_BINS = (_HIGHEST - _LOWEST) * _PER_OCTAVE


class Histogram:
    """Collects values of 0 or more. Negative values, NaN and infinity are ignored."""

    def __init__(self) -> None:
        self._pending: list[Floats] = []  # values not yet counted in bins
        self._pending_count = 0
        self._counts: NDArray[np.int64] | None = None
        self._first_bin = 0  # bin number of `_counts[0]`
        self._total = 0.0
        self._least, self._most = math.inf, 0.0

    def add(self, values: Floats) -> None:
        """Add values. The array is not copied."""
        if not len(values):
            return
        self._pending.append(values)
        self._pending_count += len(values)
        if self._pending_count > EXACT_UP_TO or len(self._pending) > _MAX_PIECES:
            self._join_pending()

    def merge(self, other: Histogram) -> None:
        if other._counts is not None:
            self._add_counts(other._first_bin, other._counts)
            self._total += other._total
            self._least, self._most = min(self._least, other._least), max(self._most, other._most)
        for values in other._pending:
            self.add(values)

    def distribution(self, bins: bool = False) -> DistributionSummary | None:
        if self._counts is not None:
            return self._binned_distribution(bins)
        values = np.sort(self._pending_values())
        if not len(values):
            return None
        points = [float(values[_rank(share, len(values)) - 1]) for share in _SHARES]
        drawn = _bins(*_bin_counts(values)) if bins else ()
        ends = float(values[0]), float(values[-1])
        return _summary(len(values), float(values.sum()), ends, points, drawn)

    def _binned_distribution(self, bins: bool) -> DistributionSummary:
        """Return the distribution of all values, including the values in `_pending`, which are not yet
        counted in bins. Leave this histogram unchanged.
        """
        whole = Histogram()
        whole.merge(self)
        whole._count_into_bins(whole._pending_values())
        counts = whole._counts
        assert counts is not None
        drawn = _bins(whole._first_bin, counts) if bins else ()
        ends = whole._least, whole._most
        return _summary(int(counts.sum()), whole._total, ends, whole._percentiles(counts), drawn)

    def _pending_values(self) -> Floats:
        values = np.concatenate(self._pending) if self._pending else np.empty(0)
        valid = (values >= 0) & (values < math.inf)  # false for NaN
        return values if valid.all() else values[valid]

    def _join_pending(self) -> None:
        values = self._pending_values()
        if len(values) > EXACT_UP_TO or self._counts is not None:
            self._count_into_bins(values)
        else:
            self._pending, self._pending_count = [values], len(values)

    def _count_into_bins(self, values: Floats) -> None:
        self._pending, self._pending_count = [], 0
        if len(values):
            self._total += float(values.sum())
            self._least = min(self._least, float(values.min()))
            self._most = max(self._most, float(values.max()))
            self._add_counts(*_bin_counts(values))

    def _add_counts(self, base: int, counts: NDArray[np.int64]) -> None:
        if self._counts is None:
            self._first_bin, self._counts = base, counts.copy()
            return
        first = min(base, self._first_bin)
        size = max(base + len(counts), self._first_bin + len(self._counts)) - first
        if size > len(self._counts):
            wider = np.zeros(size, np.int64)
            wider[self._first_bin - first : self._first_bin - first + len(self._counts)] = self._counts
            self._first_bin, self._counts = first, wider
        self._counts[base - first : base - first + len(counts)] += counts

    def _percentiles(self, counts: NDArray[np.int64]) -> list[float]:
        sums = np.cumsum(counts)
        ranks = [_rank(share, int(sums[-1])) for share in _SHARES]
        found = (np.searchsorted(sums, ranks) + self._first_bin).tolist()
        middles = [(_bin_edge(number) + _bin_edge(number + 1)) / 2 for number in found]
        return [min(max(middle, self._least), self._most) for middle in middles]


def _summary(
    count: int, total: float, ends: tuple[float, float], points: list[float], drawn: tuple[Bin, ...]
) -> DistributionSummary:
    least, most = ends
    p50, p90, p99, p999 = points
    return DistributionSummary(
        count, min(max(total / count, least), most), least, most, p50, p90, p99, p999, drawn
    )


_SHARES = (500, 900, 990, 999)  # thousandths
_MAX_PIECES = 64
_MANTISSA_BITS = 52
_BIN_SHIFT = _MANTISSA_BITS - _PER_OCTAVE.bit_length() + 1
_FIRST_BIN = (_LOWEST + 1023) * _PER_OCTAVE


def _rank(share: int, count: int) -> int:
    return -(-share * count // 1000)


def _bin_counts(values: Floats) -> tuple[int, NDArray[np.int64]]:
    """Return the number of the first bin that is not empty, and the counts from this bin on.

    The upper bits of an IEEE 754 double (exponent and first bits of the mantissa) give the bin number.
    """
    bits = np.ascontiguousarray(values).view(np.int64)
    numbers = np.clip((bits >> _BIN_SHIFT) - _FIRST_BIN, 0, _BINS - 1)
    base = int(numbers.min())
    return base, np.bincount(numbers - base)


def _bin_edge(number: int) -> float:
    """Return the lower edge of a bin; 0 for the first bin."""
    if number <= 0:
        return 0.0
    octave, part = divmod(number, _PER_OCTAVE)
    return math.ldexp(1 + part / _PER_OCTAVE, octave + _LOWEST)


def _bins(base: int, counts: NDArray[np.int64]) -> tuple[Bin, ...]:
    filled = np.flatnonzero(counts).tolist()
    return tuple(
        Bin(_bin_edge(base + each), _bin_edge(base + each + 1), int(counts[each])) for each in filled
    )
