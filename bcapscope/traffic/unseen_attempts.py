"""Attempts that were not captured, inferred from the serials around them.

Every known client on UDP counts its serials up by one per attempt, so a skipped serial is that of an attempt
that the client sent and that was not captured. It was lost before the capture point, or the capture missed
it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bcapscope.protocol.codec.frame import Frame

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call

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


def chained_call(newest: Call | None, frame: Frame) -> Call | None:
    """Return the client's newest call if a frame is its retry, and the attempt before was not captured.

    The client must be known to chain: the reserved field of its retries holds the serial of the previous
    attempt. The reserved field of `frame` names no captured attempt.
    """
    if newest is None or newest.reply is not None or newest.abandoned_at:
        return None
    skipped = skipped_serials(newest.last_attempt.item.serial, frame.serial)
    is_next = skipped[-1:] == (frame.reserved,)
    return newest if is_next and newest.request.item.raw[9:] == frame.raw[9:] else None
