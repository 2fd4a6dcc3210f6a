"""Set points that stand out: the first few of those that a finding or a table names."""

from __future__ import annotations

import math
from typing import NamedTuple

from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import Floats

MAX_LISTED = 64
"""Entries of each list of moments, the first ones; the worst ones where it says so."""


class SetPointFact(NamedTuple):
    """A set point that stands out.

    Attributes:
        call: number of its call.
        request_frame: frame of its first request.
        time: of that.
        reply_frame: frame of the accepted reply; None where there is none.
        hresult: in that reply; None likewise.
        latency_ms: from the first request to the reply; None likewise.
        cycle_ms: since the first request of the set point before; None for the first.
    """

    call: int
    request_frame: int
    time: int
    reply_frame: int | None
    hresult: int | None
    latency_ms: float | None
    cycle_ms: float | None


def set_point_fact(rows: SetPointTable, row: int, cycles: Floats) -> SetPointFact:
    """Tell about one set point; `cycles` is the time before each in ms, NaN where there is none."""
    answered, cycle = bool(rows.answered[row]), float(cycles[row])
    return SetPointFact(
        call=rows.calls[row],
        request_frame=int(rows.frames[row]),
        time=rows.origin + int(rows.times[row]),
        reply_frame=int(rows.reply_frames[row]) if answered else None,
        hresult=int(rows.codes[row]) if answered else None,
        latency_ms=int(rows.replies[row] - rows.times[row]) / 1e6 if answered else None,
        cycle_ms=None if math.isnan(cycle) else cycle,
    )
