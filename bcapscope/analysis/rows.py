"""Calls of one kind as columns, so that a million of them are not looked at one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.verdict import Outcome

_FURTHEST = 1 << 61
"""Nanoseconds; 73 years, which no capture lasts. A damaged one may claim times further apart."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Set points in the order in which they were sent.

    Times are nanoseconds since an origin that is given, frames numbers of observations.

    Attributes:
        calls: the calls themselves.
        times: of the first requests.
        arrivals: of the requests that were answered; of the first ones where none was.
        replies: of the accepted replies; equal to `times` where there is none.
        answered: where there is a reply.
        open: where there is none and the capture ended first.
        codes: HRESULT of each, 0 where there is none.
        frames: of the first requests.
        reply_frames: 0 where there is none.
        retries: of each.
        troubled: which of them were sent or answered more than once.
    """

    calls: Sequence[Exchange]
    times: NDArray[np.int64]
    arrivals: NDArray[np.int64]
    replies: NDArray[np.int64]
    answered: NDArray[np.bool_]
    open: NDArray[np.bool_]
    codes: NDArray[np.int64]
    frames: NDArray[np.int64]
    reply_frames: NDArray[np.int64]
    retries: NDArray[np.int64]
    troubled: Sequence[int]

    @property
    def latencies(self) -> NDArray[np.float64]:
        """Milliseconds from the first request to the reply; infinite where there is none."""
        taken = (self.replies - self.times) / 1e6
        return np.where(self.answered, taken, np.inf)


def rows_of(calls: Sequence[Exchange], origin: int) -> Rows:
    """Make columns of calls; `origin` is taken off all times."""
    requests = [call.request for call in calls]
    replies = [call.reply for call in calls]
    times = _times([request.time for request in requests], origin)
    answered = np.array([reply is not None for reply in replies], np.bool_)
    received = _times([origin if reply is None else reply.time for reply in replies], origin)
    rows = Rows(
        calls=calls,
        times=times,
        arrivals=times.copy(),
        replies=np.where(answered, received, times),
        answered=answered,
        open=np.zeros(len(calls), np.bool_),
        codes=np.array([0 if reply is None else reply.item.code for reply in replies], np.int64),
        frames=np.array([request.number for request in requests], np.int64),
        reply_frames=np.array([0 if reply is None else reply.number for reply in replies], np.int64),
        retries=np.zeros(len(calls), np.int64),
        troubled=[index for index, call in enumerate(calls) if call.others or not call.origin_seen],
    )
    _add_troubled(rows, origin)
    return rows


def _add_troubled(rows: Rows, origin: int) -> None:
    """Fill in what only a few calls have: retries, and no reply."""
    for index in rows.troubled:
        call = rows.calls[index]
        rows.retries[index] = call.retries
        if call.reply is not None and call.rtt is not None:
            rows.arrivals[index] = _times([call.reply.time - call.rtt], origin)[0]
    for index in np.flatnonzero(~rows.answered).tolist():
        rows.open[index] = rows.calls[index].outcome is Outcome.CAPTURE_ENDED


def _times(moments: list[int], origin: int) -> NDArray[np.int64]:
    try:
        return np.array(moments, np.int64) - origin
    except OverflowError:
        clipped = [min(max(moment - origin, -_FURTHEST), _FURTHEST) for moment in moments]
        return np.array(clipped, np.int64)
