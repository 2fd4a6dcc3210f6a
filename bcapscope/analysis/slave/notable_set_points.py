"""Facts about notable set points, which are the set points that a finding or a table names one by one."""

from __future__ import annotations

import math
from typing import NamedTuple

from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import Floats

MAX_LISTED = 64
"""Maximum number of entries in each list of notable set points. A list keeps the first entries, unless its
description says something else.
"""


class SetPointFact(NamedTuple):
    """A notable set point.

    Attributes:
        time: Time of the set point's first request, ns since 1970.
        latency_ms: Time from the first request to the accepted reply, ms; None if no reply was captured.
        cycle_ms: Time from the first request of the previous set point to the first request of this set
            point, in ms; None for the first set point.
    """

    call: int
    request_frame: int
    time: int
    reply_frame: int | None
    hresult: int | None
    latency_ms: float | None
    cycle_ms: float | None


def set_point_fact(rows: SetPointTable, row: int, cycles: Floats) -> SetPointFact:
    """Return the facts about the set point in row number `row` of `rows`. `cycles` has the cycle times in ms;
    the cycle time of the very first set point is NaN.
    """
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
