"""Estimate how far the returned pose lags behind the commanded one."""

from __future__ import annotations

import math

import numpy as np

from bcapscope.analysis.statistics.distribution import Bools, Floats

MAX_CYCLES = 32
"""Largest lag that is searched for, in cycles: at 8 ms a quarter of a second."""

_ROWS_AT_ONCE = 256
"""Set points of each run that are compared: enough for an estimate at a fraction of the time."""

_CLEAR = 4.0
"""Ratio of squared errors between the worst and the best lag; below it, the axis hardly moves."""


class AxisLag:
    """Compares each returned pose with the set points of the last cycles and finds the best match.

    The lag is an estimate. It includes the controller's buffer, the servo lag and the age of the pose when it
    was reported. Between whole cycles, it is the vertex of the parabola through the three values around the
    best.
    """

    def __init__(self, axes: int) -> None:
        self._squares = np.zeros((MAX_CYCLES + 1, axes))
        self._commanded = np.empty((0, axes))

    def add(self, commanded: Floats, returned: Floats, answered: Bools) -> None:
        """Add successive set points and, where `answered`, the poses returned for them."""
        history = np.vstack((self._commanded, commanded))
        first = len(self._commanded)
        skipped = max(0, MAX_CYCLES - first)  # rows with too few set points before them
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
        """Return the median lag of the axes; None if no axis has one."""
        found = [self.of_axis(axis) for axis in range(self._squares.shape[1])]
        lags = sorted(lag for lag in found if lag is not None)
        return lags[len(lags) // 2] if lags else None
