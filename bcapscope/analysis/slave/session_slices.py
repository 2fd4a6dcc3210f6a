"""Figures of a stay for each slice of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import DistributionSummary, Floats, Histogram
from bcapscope.protocol.tables.hresult import is_failure

MAX_SLICES = 10_000
"""Slices kept of one stay: nearly three hours of seconds. What is left off is counted."""


class SessionSlice(NamedTuple):
    """Figures of one slice of time.

    Attributes:
        begin: when it begins.
        sent: set points in it.
        retries: of them.
        refused: of them.
        unanswered: of them, those left out that were open when the capture ended or that were let go.
        cycle: None where there was none.
        latency: None likewise.
        smallest_slack_ms: as in `BufferFacts`; None likewise.
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
    """The slice that set points fall into now."""

    __slots__ = ("cycle", "latency", "number", "refused", "retries", "sent", "slack", "unanswered")

    def __init__(self, number: int) -> None:
        self.number = number
        self.sent = self.retries = self.refused = self.unanswered = 0
        self.cycle, self.latency = Histogram(), Histogram()
        self.slack = np.inf


class SessionSlicer:
    """Cuts a stay into slices of equal length, from its origin on."""

    def __init__(self, window: int, origin: int) -> None:
        """Take the length of a slice and the beginning of the first, in nanoseconds."""
        self.left_off = 0
        self._window = window
        self._origin = origin
        self._finished: list[SessionSlice] = []
        self._open: _OpenSlice | None = None

    def add(self, rows: SetPointTable, cycles: Floats, slacks: Floats) -> None:
        """Take in set points; `cycles` and `slacks` in ms, NaN where there is none.

        One that was seen before an earlier one counts with the slice that is open.
        """
        numbers = np.maximum.accumulate(rows.times // self._window)
        if self._open is not None:
            numbers = np.maximum(numbers, self._open.number)
        for number in np.unique(numbers).tolist():
            if self._open is None or number > self._open.number:
                self._close()
                self._open = _OpenSlice(number)
            self._fill(self._open, rows, np.flatnonzero(numbers == number), cycles, slacks)

    def finish(self) -> tuple[SessionSlice, ...]:
        """Return all slices that hold a set point, the last one perhaps not over."""
        self._close()
        return tuple(self._finished)

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
            self.left_off += 1
            return
        self._finished.append(
            SessionSlice(
                begin=self._origin + slot.number * self._window,
                sent=slot.sent,
                retries=slot.retries,
                refused=slot.refused,
                unanswered=slot.unanswered,
                cycle=slot.cycle.distribution(),
                latency=slot.latency.distribution(),
                smallest_slack_ms=float(slot.slack) if np.isfinite(slot.slack) else None,
            )
        )
