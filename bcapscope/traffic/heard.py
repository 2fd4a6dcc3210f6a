"""The frames of a call in trouble, found by what they hold, without a search, however many there are."""

from __future__ import annotations

from bcapscope.traffic.exchange import Exchange, FrameObservation, Role


class Heard:
    """Knows the tries and replies of one open call by their bytes and serials.

    Attributes:
        sent: when each try was seen, by its bytes; of equal ones the latest.
        reserved: what the latest try of each serial had there.
        replies: the bytes of all replies, heeded or not; notices are none.
    """

    __slots__ = ("replies", "reserved", "sent")

    def __init__(self, exchange: Exchange) -> None:
        """Begin with what is known of the call so far."""
        self.sent: dict[bytes, int] = {}
        self.reserved: dict[int, int] = {}
        self.replies: set[bytes] = set()
        self.add(Role.REQUEST, exchange.request)
        for role, seen in exchange.others:
            self.add(role, seen)
        if exchange.reply is not None:
            self.add(Role.REPLY, exchange.reply)

    def add(self, role: Role, seen: FrameObservation) -> None:
        """Take in one more frame of the call."""
        frame = seen.item
        if role in (Role.REQUEST, Role.RETRY):
            self.sent[frame.raw] = seen.time
            self.reserved[frame.serial] = frame.reserved
        elif role in (Role.REPLY, Role.LATE, Role.LOST):
            self.replies.add(frame.raw)
