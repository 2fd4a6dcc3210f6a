"""Set points as columns, so that a million of them are not looked at one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.set_point_batch import LATEST_TIME, SetPointBatch
from bcapscope.analysis.statistics.distribution import Bools, Floats
from bcapscope.traffic.call import Call


@dataclass(frozen=True, slots=True)
class SetPointTable:
    """Set points in the order in which they were sent.

    Times are nanoseconds since an origin that is given, frames numbers of observations.

    Attributes:
        origin: nanoseconds since 1970-01-01 UTC.
        calls: numbers of the calls.
        times: of the first requests.
        arrivals: of the requests that were answered; of the first ones where none was.
        replies: of the accepted replies; equal to `times` where there is none.
        answered: where there is a reply.
        open: where there is none and one may have come that was not seen: the capture ended first, or the
            call was let go.
        codes: HRESULT of each, 0 where there is none.
        frames: of the first requests.
        reply_frames: 0 where there is none.
        retries: of each.
        irregular: place and call of those that have more to tell: not answered, not with S_OK, or sent or
            answered more than once.
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
        """Milliseconds from the first request to the reply; infinite where there is none."""
        taken: Floats = (self.replies - self.times) / 1e6
        taken[~self.answered] = np.inf
        return taken


def table_of(batch: SetPointBatch, origin: int) -> SetPointTable:
    """Make columns of a batch, which holds at least one set point; `origin` is taken off all times."""
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
