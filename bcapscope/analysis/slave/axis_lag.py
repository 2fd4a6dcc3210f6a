"""How far the returned pose is behind the commanded one."""

from __future__ import annotations

import math

import numpy as np

from bcapscope.analysis.statistics.distribution import Bools, Floats

MAX_CYCLES = 32
"""Larger lags are not looked for: at 8 ms that is a quarter of a second."""

_ROWS_AT_ONCE = 256
"""Of each run of set points so many are compared: enough for an estimate at a fraction of the time."""

_CLEAR = 4.0
"""The best lag must fit so much better than the worst, by squares, or the axis hardly moves."""


class AxisLag:
    """Compares each returned pose with the set points of the last cycles and finds which fits best.

    The lag is an estimate: it holds what the controller buffers, what the servo lags and how old the pose was
    when it was reported. Between whole cycles it is the vertex of the parabola through the three best.
    """

    def __init__(self, axes: int) -> None:
        self._squares = np.zeros((MAX_CYCLES + 1, axes))
        self._commanded = np.empty((0, axes))

    def add(self, commanded: Floats, returned: Floats, answered: Bools) -> None:
        """Take in set points that follow each other and, where `answered`, what came back for each."""
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
        """Return the lag in cycles; None where the axis moves too little, or too irregularly, to tell."""
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
        """Return the median of the axes that have one; None where none has."""
        found = [self.of_axis(axis) for axis in range(self._squares.shape[1])]
        lags = sorted(lag for lag in found if lag is not None)
        return lags[len(lags) // 2] if lags else None
