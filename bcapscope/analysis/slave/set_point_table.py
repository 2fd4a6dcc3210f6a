"""Set points as columns (NumPy arrays), so that many set points can be processed together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.set_point_batch import LATEST_TIME, SetPointBatch
from bcapscope.analysis.statistics.distribution import Bools, Floats
from bcapscope.traffic.call import Call


@dataclass(frozen=True, slots=True)
class SetPointTable:
    """A table with one row for each set point. The rows are in the order in which the set points were sent.

    Times are in ns since `origin`. Frames are given by their observation numbers.

    Attributes:
        origin: Time from which all times in the table are counted, in ns since 1970.
        times: Time of each set point's request, which is its first captured attempt.
        arrivals: Time of each answered attempt. If no reply was captured, this is the time of the request.
        replies: Time of each accepted reply. If no reply was captured, this is the time of the request.
        open: Whether a set point without a captured reply may have been answered: the capture ended before
            the reply, or the call was evicted from memory.
        codes: HRESULT of each reply; 0 if no reply was captured.
        reply_frames: Frame number of each accepted reply; 0 if no reply was captured.
        irregular: Index and call of each irregular set point (see `SetPointBatch`).
    """

    origin: int
    calls: Sequence[int]
    times: NDArray[np.int64]
    arrivals: NDArray[np.int64]
    replies: NDArray[np.int64]
    answered: Bools
    open: Bools
    codes: NDArray[np.int64]
    frames: NDArray[np.int64]
    reply_frames: NDArray[np.int64]
    retries: NDArray[np.int64]
    irregular: Sequence[tuple[int, Call]]

    @property
    def latencies(self) -> Floats:
        """Time from the first request to the reply of each set point, ms; infinity without a reply."""
        taken: Floats = (self.replies - self.times) / 1e6
        taken[~self.answered] = np.inf
        return taken

    def fact(self, row: int, cycles: Floats) -> SetPointFact:
        """`cycles` has the cycle time before each set point, ms; NaN for the very first set point."""
        answered, cycle = bool(self.answered[row]), float(cycles[row])
        return SetPointFact(
            call=self.calls[row],
            request_frame=int(self.frames[row]),
            time=self.origin + int(self.times[row]),
            reply_frame=int(self.reply_frames[row]) if answered else None,
            hresult=int(self.codes[row]) if answered else None,
            latency_ms=int(self.replies[row] - self.times[row]) / 1e6 if answered else None,
            cycle_ms=None if math.isnan(cycle) else cycle,
        )


def table_of(batch: SetPointBatch, origin: int) -> SetPointTable:
    """Return the set points of a batch, with times relative to `origin`. The batch must not be empty."""
    calls, frames, times, reply_frames, replied = batch.columns()
    count = len(calls)
    rows = SetPointTable(
        origin=origin,
        calls=calls.tolist(),
        times=times - origin,
        arrivals=times - origin,
        replies=replied - origin,
        answered=reply_frames > 0,
        open=np.zeros(count, np.bool_),
        codes=np.zeros(count, np.int64),
        frames=frames,
        reply_frames=reply_frames,
        retries=np.zeros(count, np.int64),
        irregular=tuple(batch.irregular),
    )
    for index, call in batch.irregular:
        _fill_irregular(rows, index, call)
    return rows


def _fill_irregular(rows: SetPointTable, index: int, call: Call) -> None:
    rows.retries[index] = call.retries
    if call.reply is None or call.rtt is None:
        rows.open[index] = not call.surely_unanswered
        return
    rows.codes[index] = call.reply.item.code
    rows.arrivals[index] = min(max(call.reply.time - call.rtt, -LATEST_TIME), LATEST_TIME) - rows.origin
