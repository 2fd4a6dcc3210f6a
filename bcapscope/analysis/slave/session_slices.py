"""Figures of a slave-mode session for each slice of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import Floats, Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.protocol.tables.hresult import is_failure

MAX_SLICES = 10_000
"""Maximum number of kept slices: nearly three hours in slices of one second."""


class SessionSlice(NamedTuple):
    """Figures of a slave-mode session in one slice of time.

    Attributes:
        begin: Start of the slice, ns since 1970.
        unanswered: Number of set points without a reply, except those that were evicted from memory or still
            open at the end of the capture.
        cycle: Cycle times in the slice, ms; None if no cycle time is known.
        latency: Latencies of the answered set points in the slice, ms; None if no set point was answered.
        smallest_slack_ms: Smallest slack in the slice, ms (see `BufferFacts`); None if no slack is known.
    """

    begin: int
    sent: int
    retries: int
    refused: int
    unanswered: int
    cycle: DistributionSummary | None
    latency: DistributionSummary | None
    smallest_slack_ms: float | None


class _OpenSlice:
    def __init__(self, number: int) -> None:
        self.number = number
        self.sent = self.retries = self.refused = self.unanswered = 0
        self.cycle, self.latency = Histogram(), Histogram()
        self.slack = np.inf


class SessionSlicer:
    """Divides a slave-mode session into slices of `window` ns. The first slice starts at `origin`."""

    def __init__(self, window: int, origin: int) -> None:
        self._left_off = 0
        self._window = window
        self._origin = origin
        self._finished: list[SessionSlice] = []
        self._open: _OpenSlice | None = None

    def add(self, rows: SetPointTable, cycles: Floats, slacks: Floats) -> None:
        """Add set points with their cycle times and slacks (see `BufferFacts.smallest_slack_ms`) in ms; NaN
        if unknown. A slice that has ended does not change. Therefore a set point with a time before the
        current slice counts in the current slice.
        """
        numbers = np.maximum.accumulate(rows.times // self._window)
        if self._open is not None:
            numbers = np.maximum(numbers, self._open.number)
        for number in np.unique(numbers).tolist():
            if self._open is None or number > self._open.number:
                self._close()
                self._open = _OpenSlice(number)
            self._fill(self._open, rows, np.flatnonzero(numbers == number), cycles, slacks)

    def slices(self) -> tuple[tuple[SessionSlice, ...], int]:
        """Return the first slices that have set points, and the number of further slices."""
        latest = [] if self._open is None else [self._slice(self._open)]
        slices = (*self._finished, *latest)
        return slices[:MAX_SLICES], self._left_off + len(slices[MAX_SLICES:])

    def _fill(
        self, slot: _OpenSlice, rows: SetPointTable, chosen: NDArray[np.int64], cycles: Floats, slacks: Floats
    ) -> None:
        answered = rows.answered[chosen]
        codes = rows.codes[chosen]
        slot.sent += len(chosen)
        slot.retries += int(rows.retries[chosen].sum())
        slot.refused += sum(map(is_failure, codes[codes != 0].tolist()))
        slot.unanswered += int((~answered & ~rows.open[chosen]).sum())
        slot.cycle.add(cycles[chosen])
        slot.latency.add(rows.latencies[chosen][answered])
        slot.slack = min(slot.slack, float(np.fmin.reduce(slacks[chosen], initial=np.inf)))

    def _close(self) -> None:
        slot, self._open = self._open, None
        if slot is None:
            return
        if len(self._finished) >= MAX_SLICES:
            self._left_off += 1
        else:
            self._finished.append(self._slice(slot))

    def _slice(self, slot: _OpenSlice) -> SessionSlice:
        return SessionSlice(
            begin=self._origin + slot.number * self._window,
            sent=slot.sent,
            retries=slot.retries,
            refused=slot.refused,
            unanswered=slot.unanswered,
            cycle=slot.cycle.distribution(),
            latency=slot.latency.distribution(),
            smallest_slack_ms=float(slot.slack) if np.isfinite(slot.slack) else None,
        )
