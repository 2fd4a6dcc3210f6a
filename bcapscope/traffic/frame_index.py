"""The frames of a call in trouble, found by what they hold, without a search, however many there are."""

from __future__ import annotations

from bcapscope.traffic.call import Call, FrameObservation, FrameRole


class FrameIndex:
    """Knows the tries and replies of one open call by their bytes and serials.

    Attributes:
        sent_at: when each try was seen, by its bytes; of equal ones the latest.
        reserved_by_serial: what the latest try of each serial had there.
        reply_bytes: the bytes of all replies, heeded or not; notices are none.
    """

    __slots__ = ("reply_bytes", "reserved_by_serial", "sent_at")

    def __init__(self, call: Call) -> None:
        """Begin with what is known of the call so far."""
        self.sent_at: dict[bytes, int] = {}
        self.reserved_by_serial: dict[int, int] = {}
        self.reply_bytes: set[bytes] = set()
        self.add_frame(FrameRole.REQUEST, call.request)
        for role, seen in call.other_frames:
            self.add_frame(role, seen)
        if call.reply is not None:
            self.add_frame(FrameRole.REPLY, call.reply)

    def add_frame(self, role: FrameRole, observation: FrameObservation) -> None:
        """Take in one more frame of the call."""
        frame = observation.item
        if role in (FrameRole.REQUEST, FrameRole.RETRY):
            self.sent_at[frame.raw] = observation.time
            self.reserved_by_serial[frame.serial] = frame.reserved
        elif role in (FrameRole.REPLY, FrameRole.LATE, FrameRole.LOST):
            self.reply_bytes.add(frame.raw)
