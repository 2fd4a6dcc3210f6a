"""Attempts that were not captured, inferred from the serials around them.

On UDP, every known client increments the serial by one per attempt. A skipped serial therefore belongs to an
attempt that was not captured. The network lost this attempt before the capture point, or the capture missed
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bcapscope.protocol.codec.frame import Frame

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, StrayReply

MAX_UNSEEN = 64
"""Maximum number of successive attempts that were not captured. A larger gap in the serials shows something
else, such as a restart of the client."""


MAX_RECENT = 1024
"""A serial counts as recent if it differs from the latest serial by at most this number. `serial_table`
remembers the serials of at least as many settled calls.
"""


def skipped_serials(before: int, after: int) -> tuple[int, ...]:
    """Return the serials between those of two successive captured frames of a client, oldest first.

    The result is empty if the gap is too large to be caused by attempts that were not captured. Serial 0 is
    left out, because most clients skip it.
    """
    gap = (after - before) & 0xFFFF
    if gap > MAX_UNSEEN + 1:
        return ()
    return tuple(serial for step in range(1, gap) if (serial := (before + step) & 0xFFFF))


class UnseenRequests:
    """The stray replies of one client that answer requests which were not captured.

    There are three cases. First, the client skipped the serial of the reply. Second, the client used this
    serial before the capture began. Third, the serial follows the client's latest captured serial. In the
    third case, the request may be a retry of the client's newest call. The next request shows whether the
    client has used the serial.

    Attributes:
        waiting: Whether the serial of the next request can change `request_missed` of a stray reply.
    """

    def __init__(self) -> None:
        # stray replies, each with the newest call at the time of the reply
        self._ahead: list[tuple[StrayReply, Call]] = []
        self.waiting = False

    def add_stray_reply(self, stray: StrayReply, newest: Call | None) -> None:
        """Set `request_missed` of a stray reply, which belongs to no known call."""
        if newest is None or stray.call_number is not None:
            return
        serial, latest = stray.observation.item.serial, newest.last_attempt.item.serial
        stray.request_missed = 0 < (latest - serial) & 0xFFFF <= MAX_RECENT
        if 0 < (serial - latest) & 0xFFFF <= MAX_UNSEEN:
            stray.request_missed = newest.is_guess = self.waiting = True
            self._ahead.append((stray, newest))
            del self._ahead[:-MAX_UNSEEN]

    def check_next_request(self, serial: int) -> None:
        """Set `request_missed` of earlier stray replies to False if the client uses their serials only now or
        later.

        A copy of the client's latest frame has no effect.
        """
        for stray, newest in self._ahead:
            latest = newest.last_attempt.item.serial
            if serial == latest:
                return
            if (serial - latest) & 0xFFFF <= (stray.observation.item.serial - latest) & 0xFFFF:
                stray.request_missed = newest.is_guess = False
        self._ahead.clear()
        self.waiting = False


def call_of_unseen_attempt(
    newest: Call | None, open_calls: Sequence[Call], frame: Frame, chains: bool
) -> Call | None:
    """Return the client's newest call if a frame is a retry of this call after an attempt that was not
    captured. The reserved field of the frame names the attempt that was not captured. `is_guess` of the
    newest call becomes True if the attempt may belong to another call with the same request.

    Args:
        newest: The client's newest call; None if there is none.
        open_calls: The client's open calls, oldest first.
        chains: Whether the client is known to name the previous attempt in the reserved field, not the first
            attempt.
    """
    if newest is None or newest.request.item.raw[9:] != frame.raw[9:]:
        return None
    if skipped_serials(newest.last_attempt.item.serial, frame.serial)[-1:] != (frame.reserved,):
        return None
    is_open = chains and newest.reply is None and not newest.abandoned_at
    before = open_calls[-2] if len(open_calls) > 1 else None
    if not is_open or before is None or before.request.item.raw[9:] == frame.raw[9:]:
        newest.is_guess = True
    return newest if is_open else None
