"""Samples of a slave-mode session for plots, bounded for long sessions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.statistics.distribution import Floats

MAX_SAMPLES = 2048
"""More samples than a plot on a large screen is pixels wide."""

# Columns of a run: time and frame of the first set point, number of set points, extremes; poses follow.
_TIME, _FRAME, _POINTS, _CYCLE_LEAST, _CYCLE_MOST, _LATENCY_MOST, _SLACK_LEAST = range(7)
_HEAD = 7


class PlotSample(NamedTuple):
    """A run of successive set points, summarised for plots.

    Attributes:
        frame: Request frame of the first set point.
        cycle_least: Shortest cycle in the run, ms; NaN without one.
        cycle_most: Longest cycle in the run, ms; NaN without one.
        latency_most: Longest latency, ms; NaN without a reply.
        slack_least: Smallest slack, ms, as in `BufferFacts.smallest_slack_ms`; NaN for the very first set
            point.
        commanded: Commanded pose of the first set point; NaN if unreadable.
        returned: Pose in the reply to the first set point; NaN if there is none.
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
    """Summarises runs of set points, one row per run.

    When there are too many runs, it doubles their length.
    """

    def __init__(self, axes: int, origin: int) -> None:
        """Create a sampler for `axes` axes; times count from `origin` in ns."""
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
        """Add set points.

        Args:
            times: Times since the origin, ns.
            figures: Cycles, latencies and slacks in ms; NaN where there is none.
        """
        cycles, latencies, slacks = figures
        ones = np.ones(len(times))
        head = np.column_stack((times, frames, ones, cycles, cycles, latencies, slacks))
        rows: Floats = np.hstack((head, *poses))
        into = -self._total % self._length  # rows that belong to the last run
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
    """Summarise each run of rows in one row; runs begin at `starts`."""
    runs = rows[starts]
    runs[:, _POINTS] = np.add.reduceat(rows[:, _POINTS], starts)
    for column in (_CYCLE_LEAST, _SLACK_LEAST):
        runs[:, column] = np.fmin.reduceat(rows[:, column], starts)
    for column in (_CYCLE_MOST, _LATENCY_MOST):
        runs[:, column] = np.fmax.reduceat(rows[:, column], starts)
    return runs
