"""Samples of a slave-mode session for plots. Even a long session has at most `MAX_SAMPLES` samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.statistics.distribution import Floats

MAX_SAMPLES = 2048
"""Maximum number of samples of a slave-mode session: more than the width of a plot in pixels."""

# Indexes of the columns of a sample. The columns from `_HEAD` on contain the poses.
_TIME, _FRAME, _POINTS, _CYCLE_LEAST, _CYCLE_MOST, _LATENCY_MOST, _SLACK_LEAST = range(7)
_HEAD = 7


class PlotSample(NamedTuple):
    """Summary of successive set points for plots. An unknown number is NaN.

    Attributes:
        time: Time of the first set point, ns since 1970.
        cycle_least: Shortest cycle time in the sample, ms.
        cycle_most: Longest cycle time in the sample, ms.
        latency_most: Longest latency in the sample, ms.
        slack_least: Smallest slack in the sample, ms (see `BufferFacts.smallest_slack_ms`).
        returned: Pose in the reply to the sample's first set point.
    """

    time: int
    frame: int
    points: int
    cycle_least: float
    cycle_most: float
    latency_most: float
    slack_least: float
    commanded: tuple[float, ...]
    returned: tuple[float, ...]


class PlotSampler:
    """Summarises successive set points as samples. Beyond `MAX_SAMPLES`, pairs of samples are joined."""

    def __init__(self, axes: int, origin: int) -> None:
        self._axes = axes
        self._origin = origin
        self._runs = np.empty((0, _HEAD + 2 * axes))
        self._length = 1
        self._total = 0

    def add(
        self,
        times: NDArray[np.int64],
        frames: NDArray[np.int64],
        figures: tuple[Floats, Floats, Floats],
        poses: tuple[Floats, Floats],
    ) -> None:
        """Add set points. `times` are in ns since `origin`. `figures` are cycle times, latencies and slacks
        in ms, with NaN for a missing value.
        """
        cycles, latencies, slacks = figures
        ones = np.ones(len(times))
        head = np.column_stack((times, frames, ones, cycles, cycles, latencies, slacks))
        rows: Floats = np.hstack((head, *poses))
        # The newest sample may contain fewer than `_length` set points. Then it takes the first `into` of the
        # new rows.
        into = -self._total % self._length
        starts = np.arange(into, len(rows), self._length)
        if into:
            starts = np.concatenate(([0], starts))
            rows = np.vstack((self._runs[-1:], rows))
            starts[1:] += 1
            self._runs = self._runs[:-1]
        self._runs = np.vstack((self._runs, _sum_up_runs(rows, starts)))
        self._total += len(times)
        while len(self._runs) > MAX_SAMPLES:
            self._runs = _sum_up_runs(self._runs, np.arange(0, len(self._runs), 2))
            self._length *= 2

    def samples(self) -> tuple[PlotSample, ...]:
        return tuple(self._sample(row) for row in self._runs.tolist())

    def _sample(self, row: list[float]) -> PlotSample:
        middle = _HEAD + self._axes
        return PlotSample(
            time=self._origin + int(row[_TIME]),
            frame=int(row[_FRAME]),
            points=int(row[_POINTS]),
            cycle_least=row[_CYCLE_LEAST],
            cycle_most=row[_CYCLE_MOST],
            latency_most=row[_LATENCY_MOST],
            slack_least=row[_SLACK_LEAST],
            commanded=tuple(row[_HEAD:middle]),
            returned=tuple(row[middle:]),
        )


def _sum_up_runs(rows: Floats, starts: NDArray[np.int64]) -> Floats:
    """Summarise rows as samples. `starts` has the index of the first row of each sample."""
    runs = rows[starts]
    runs[:, _POINTS] = np.add.reduceat(rows[:, _POINTS], starts)
    for column in (_CYCLE_LEAST, _SLACK_LEAST):
        runs[:, column] = np.fmin.reduceat(rows[:, column], starts)
    for column in (_CYCLE_MOST, _LATENCY_MOST):
        runs[:, column] = np.fmax.reduceat(rows[:, column], starts)
    return runs
