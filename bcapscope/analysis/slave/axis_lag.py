"""Estimate how long the robot's returned pose lags behind the commanded pose."""

from __future__ import annotations

import math

import numpy as np

from bcapscope.analysis.statistics.distribution import Bools, Floats

MAX_CYCLES = 32
"""Largest lag in cycles that `AxisLag` tries: a quarter of a second at a cycle time of 8 ms."""

_ROWS_AT_ONCE = 256
"""Maximum number of set points that one call of `add` compares: enough for an estimate, and fast."""

_CLEAR = 4.0
"""`AxisLag` computes one sum of squared errors for each lag that it tries. It returns the best lag only if
the largest sum is more than this many times the smallest sum.
"""


class AxisLag:
    """Estimates the lag at which the returned poses match the commanded poses best.

    The lag includes the time in the controller's buffer, the servo lag, and the age of the reported pose.
    `AxisLag` sums the squared pose errors for each lag in whole cycles. A parabola through the smallest sum
    and its two neighbours gives the lag in fractions of a cycle.
    """

    def __init__(self, axes: int) -> None:
        self._squares = np.zeros((MAX_CYCLES + 1, axes))
        self._commanded = np.empty((0, axes))

    def add(self, commanded: Floats, returned: Floats, answered: Bools) -> None:
        """Add successive set points; `answered` shows which of them have a returned pose."""
        history = np.vstack((self._commanded, commanded))
        first = len(self._commanded)
        # Skip the first set points of the session: they have too few set points before them.
        skipped = max(0, MAX_CYCLES - first)
        until = min(len(commanded), skipped + _ROWS_AT_ONCE)
        if until > skipped:
            came, missing = returned[skipped:until], ~answered[skipped:until]
            for cycles in range(MAX_CYCLES + 1):
                off = came - history[first + skipped - cycles : first + until - cycles]
                off[missing] = 0.0
                self._squares[cycles] += np.einsum("ij,ij->j", off, off)
        self._commanded = history[-MAX_CYCLES:]

    def of_axis(self, axis: int) -> float | None:
        """Return the lag of an axis in cycles; None if the axis moves too little or too irregularly."""
        squares = self._squares[:, axis]
        best = int(squares.argmin())
        least, most = float(squares[best]), float(squares.max())
        if not math.isfinite(most) or most <= _CLEAR * least or best == MAX_CYCLES:
            return None
        middle = max(best, 1)
        before, at, after = squares[middle - 1 : middle + 2].tolist()
        bend = before - 2 * at + after
        vertex = middle + (before - after) / (2 * bend) if bend > 0 else float(best)
        return float(max(vertex, 0.0))

    def of_all(self) -> float | None:
        """Return the median lag of all axes in cycles; None if the lag of every axis is unknown."""
        found = [self.of_axis(axis) for axis in range(self._squares.shape[1])]
        lags = sorted(lag for lag in found if lag is not None)
        return lags[len(lags) // 2] if lags else None
