"""Set points as columns, so that a million of them are not looked at one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.distribution import Bools, Floats
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.verdict import Outcome

_FURTHEST = 1 << 61
"""Nanoseconds; 73 years, which no capture lasts. A damaged one may claim times further apart."""


Row: TypeAlias = "tuple[int, int, int, bytes, int, int, bytes]"
"""What is kept of a set point until many are looked at together: number of the call; frame, time and bytes of
the first request; frame, time and bytes of the accepted reply. Where there is no reply its frame is 0, its
time that of the request, and there are no bytes. A plain tuple takes a third of the time of a named one."""


def row_of(call: Exchange) -> Row:
    """Take a call down to a row."""
    request, reply = call.request, call.reply
    number, time, raw = request.number, request.time, request.item.raw
    if reply is None:
        return call.call, number, time, raw, 0, time, b""
    return call.call, number, time, raw, reply.number, reply.time, reply.item.raw


def frame_of(row: Row) -> int:
    """Return the frame of the first request."""
    return row[1]


def sent_at(row: Row) -> int:
    """Return when the first request was seen."""
    return row[2]


def request_of(row: Row) -> bytes:
    """Return the bytes of the first request."""
    return row[3]


def replied_at(row: Row) -> int:
    """Return when the reply was seen, or the request where there is none."""
    return row[5]


@dataclass(frozen=True, slots=True)
class Rows:
    """Set points in the order in which they were sent.

    Times are nanoseconds since an origin that is given, frames numbers of observations.

    Attributes:
        origin: nanoseconds since 1970-01-01 UTC.
        calls: numbers of the calls.
        raws: bytes of the first requests.
        results: bytes of the accepted replies; empty where there is none.
        times: of the first requests.
        arrivals: of the requests that were answered; of the first ones where none was.
        replies: of the accepted replies; equal to `times` where there is none.
        answered: where there is a reply.
        open: where there is none and the capture ended first.
        codes: HRESULT of each, 0 where there is none.
        frames: of the first requests.
        reply_frames: 0 where there is none.
        retries: of each.
        odd: place and call of those that have more to tell: not answered, not with S_OK, or sent or answered
            more than once.
    """

    origin: int
    calls: Sequence[int]
    raws: Sequence[bytes]
    results: Sequence[bytes]
    times: NDArray[np.int64]
    arrivals: NDArray[np.int64]
    replies: NDArray[np.int64]
    answered: Bools
    open: Bools
    codes: NDArray[np.int64]
    frames: NDArray[np.int64]
    reply_frames: NDArray[np.int64]
    retries: NDArray[np.int64]
    odd: Sequence[tuple[int, Exchange]]

    @property
    def latencies(self) -> Floats:
        """Milliseconds from the first request to the reply; infinite where there is none."""
        taken: Floats = (self.replies - self.times) / 1e6
        taken[~self.answered] = np.inf
        return taken


def rows_of(rows: Sequence[Row], odd: Sequence[tuple[int, Exchange]], origin: int) -> Rows:
    """Make columns of rows, of which there is at least one.

    Args:
        rows: in the order in which they were sent.
        odd: place and call of those that have more to tell.
        origin: is taken off all times.
    """
    calls, frames, times, raws, reply_frames, replied, results = zip(*rows, strict=True)
    sent = _times(times, origin)
    reply_numbers = np.array(reply_frames, np.int64)
    made = Rows(
        origin=origin,
        calls=calls,
        raws=raws,
        results=results,
        times=sent,
        arrivals=sent.copy(),
        replies=_times(replied, origin),
        answered=reply_numbers > 0,
        open=np.zeros(len(rows), np.bool_),
        codes=np.zeros(len(rows), np.int64),
        frames=np.array(frames, np.int64),
        reply_frames=reply_numbers,
        retries=np.zeros(len(rows), np.int64),
        odd=tuple(odd),
    )
    for index, call in odd:
        _fill(made, index, call)
    return made


def _fill(rows: Rows, index: int, call: Exchange) -> None:
    rows.retries[index] = call.retries
    if call.reply is None or call.rtt is None:
        rows.open[index] = call.outcome is Outcome.CAPTURE_ENDED
        return
    rows.codes[index] = call.reply.item.code
    rows.arrivals[index] = _times((call.reply.time - call.rtt,), rows.origin)[0]


def _times(moments: Sequence[int], origin: int) -> NDArray[np.int64]:
    try:
        return np.array(moments, np.int64) - origin
    except OverflowError:
        clipped = [min(max(moment - origin, -_FURTHEST), _FURTHEST) for moment in moments]
        return np.array(clipped, np.int64)
