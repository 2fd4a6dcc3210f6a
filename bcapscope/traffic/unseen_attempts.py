"""Attempts that were not captured, inferred from the serials around them.

On UDP, every known client increments the serial by one per attempt. A skipped serial therefore belongs to an
attempt that was not captured. The network lost the skipped attempt before the capture point, or the capture
missed it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bcapscope.protocol.codec.frame import Frame

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, StrayReply

MAX_UNSEEN = 64
"""Maximum number of successive attempts that were not captured. A larger gap in the serials has another
cause, such as a restart of the client.
"""


MAX_RECENT = 1024
"""A serial counts as recent if it differs from the latest serial by at most this number. `serial_table`
remembers at least this number of serials of settled calls.
"""


def skipped_serials(before: int, after: int) -> tuple[int, ...]:
    """Return the serials between the serials of two successive captured frames of a client, oldest first.

    The result is empty if the gap is too large to be caused by attempts that were not captured. The result
    never contains serial 0, because most clients skip it.
    """
    gap = (after - before) & 0xFFFF
    if gap > MAX_UNSEEN + 1:
        return ()
    return tuple(serial for step in range(1, gap) if (serial := (before + step) & 0xFFFF))


class UnseenRequests:
    """Stray replies of one client to requests that were not captured. The serial of a stray reply is either
    older or newer than the client's latest captured serial. If the serial is older, the client sent the
    request before the capture began, or the capture missed it. If the serial is newer, the request may be a
    retry of the client's newest call. The client's next request shows whether the client has used a newer
    serial.

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
        """Set `request_missed` of earlier stray replies to False if the client had not used their serials
        before this request.

        If the request is a copy of the client's latest request, nothing changes.
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
    """Return the client's newest call if a frame is a retry of this call whose reserved field names an
    attempt that was not captured. Set `is_guess` of the newest call if the frame may belong to another call
    with the same request.

    Args:
        newest: The client's newest call; None if there is none.
        open_calls: The client's open calls, oldest first.
        chains: Whether the client is known to name the previous attempt in the reserved field, instead of the
            first attempt.
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
