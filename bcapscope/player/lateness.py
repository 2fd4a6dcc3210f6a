"""How late the player sends set points, recorded without allocating memory during the motion."""

from __future__ import annotations

import math
from array import array

import msgspec
import numpy as np

_BINS_PER_OCTAVE = 16
"""Bins per power of two. An estimated percentile differs by at most 7 % from the exact percentile."""

_BINS = 64 * _BINS_PER_OCTAVE
_PERCENTILES = (0.5, 0.99, 0.999)

MAX_REPORTED_BINS = 40
"""Maximum number of bins in a progress report, so that one write to the pipe suffices."""


class Spread(msgspec.Struct, frozen=True):
    """Distribution of values in ns. 99 % of all values are at most `p99`."""

    count: int = 0
    p50: int = 0
    p99: int = 0
    p999: int = 0
    most: int = 0


class Lateness:
    """Records the lateness of every set point in ns."""

    def __init__(self, capacity: int) -> None:
        """Allocate memory for the first `capacity` values. All later values are counted only in bins."""
        self._values = array("q", bytes(8 * capacity))
        self._capacity = capacity
        self._bins = array("q", bytes(8 * _BINS))
        self._counts = np.frombuffer(self._bins, dtype=np.int64)
        self._count = 0
        self._maximum = 0

    def add(self, late: int) -> None:
        """Record how late one set point was, in ns; `late` must not be negative."""
        if self._count < self._capacity:
            self._values[self._count] = late
        self._count += 1
        self._bins[_bin_of(late)] += 1
        self._maximum = max(self._maximum, late)

    def estimated_spread(self) -> Spread:
        """Return estimated percentiles, fast: the upper edge of the bin that holds each percentile."""
        if not self._count:
            return Spread()
        wanted = [_rank(share, self._count) for share in _PERCENTILES]
        places = np.searchsorted(np.cumsum(self._counts), wanted).tolist()
        p50, p99, p999 = (min(_upper_edge(number), self._maximum) for number in places)
        return Spread(self._count, p50, p99, p999, self._maximum)

    def bins(self) -> tuple[tuple[int, int, int], ...]:
        """Return the `MAX_REPORTED_BINS` fullest bins, each as smallest value, largest value and count."""
        filled = [(self._bins[number], number) for number in np.flatnonzero(self._counts).tolist()]
        if len(filled) > MAX_REPORTED_BINS:
            filled = sorted(filled, reverse=True)[:MAX_REPORTED_BINS]
        edges = ((_upper_edge(number - 1) + 1, _upper_edge(number), count) for count, number in filled)
        return tuple(sorted(edges))

    def exact_spread(self) -> Spread:
        """Return exact percentiles. This takes longer than `estimated_spread`. If more values than `capacity`
        were added, return estimated percentiles.
        """
        if not 0 < self._count <= self._capacity:
            return self.estimated_spread()
        values = sorted(self._values[: self._count])
        p50, p99, p999 = (values[_rank(share, self._count) - 1] for share in _PERCENTILES)
        return Spread(self._count, p50, p99, p999, self._maximum)


def _rank(share: float, count: int) -> int:
    return max(1, math.ceil(share * count))


def _bin_of(value: int) -> int:
    """Each value below 16 has its own bin. Values from 16 upwards share 16 bins per power of two."""
    if value < _BINS_PER_OCTAVE:
        return max(value, 0)
    shift = value.bit_length() - 5
    return min((shift << 4) + (value >> shift), _BINS - 1)


def _upper_edge(number: int) -> int:
    if number < _BINS_PER_OCTAVE:
        return number
    shift = (number >> 4) - 1
    return (((number & 15) + 17) << shift) - 1
