"""Attempts that were not captured, inferred from the serials around them.

Every known client on UDP counts its serials up by one per attempt, so a skipped serial is that of an attempt
that the client sent and that was not captured. It was lost before the capture point, or the capture missed
it.
"""

from __future__ import annotations

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call
from bcapscope.traffic.pairing_states import AWAITING_REPLY
from bcapscope.traffic.reserved_field import ReservedConvention, ReservedFieldUsage

MAX_UNSEEN = 16
"""Maximum number of successive attempts without a captured one between them. A larger gap in the serials
shows something else, such as a client that began anew."""


def skipped_serials(before: int, after: int) -> tuple[int, ...]:
    """Return the serials between those of two successive captured frames of a client, oldest first.

    The result is empty if the gap is too large to be one of missed attempts. Serial 0 is left out, because
    most clients skip it.
    """
    gap = (after - before) & 0xFFFF
    if gap > MAX_UNSEEN + 1:
        return ()
    return tuple(serial for step in range(1, gap) if (serial := (before + step) & 0xFFFF))


def is_unseen_serial(latest: int, serial: int) -> bool:
    """Return whether a reply's serial is one that the client uses next after its latest captured frame.

    The reply then answers a request that was not captured.
    """
    return 0 < (serial - latest) & 0xFFFF <= MAX_UNSEEN


def chained_call(newest: Call | None, usage: ReservedFieldUsage, frame: Frame) -> Call | None:
    """Return the newest call if a frame is its retry and names an attempt that was not captured."""
    if newest is None or newest.state not in AWAITING_REPLY:
        return None
    if usage.convention is not ReservedConvention.CHAIN:
        return None
    return newest if is_chained_retry(newest, frame) else None


def is_chained_retry(call: Call, frame: Frame) -> bool:
    """Return whether a frame is a retry of `call` whose previous attempt was not captured.

    The client must be known to chain: the reserved field of its retries holds the serial of the previous
    attempt.
    """
    skipped = skipped_serials(call.last_attempt.item.serial, frame.serial)
    return skipped[-1:] == (frame.reserved,) and call.request.item.raw[9:] == frame.raw[9:]
