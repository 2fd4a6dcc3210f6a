"""Facts about notable set points, which are the set points that a finding or a table names one by one."""

from __future__ import annotations

from typing import NamedTuple

MAX_LISTED = 64
"""Maximum length of each list of notable set points, such as the refused ones. If a session has more, most
lists contain only the first ones.
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
