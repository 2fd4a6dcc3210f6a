"""Index of the frames of one call. The time for finding a frame does not depend on the number of frames."""

from __future__ import annotations

from bcapscope.traffic.call import Call, FrameObservation, FrameRole
from bcapscope.traffic.joining.joined_observation import JoinedObservation

_REPLIES = (FrameRole.REPLY, FrameRole.LATE, FrameRole.LOST)


class FrameIndex:
    """For one open call, the latest capture time of each attempt and reply. The key is the frame's bytes. The
    index leaves out notices, and replies that did not reach the client's side.
    """

    def __init__(self, call: Call) -> None:
        self.sent_at: dict[bytes, int] = {}
        self.reserved_by_serial: dict[int, int] = {}
        self.received_at: dict[bytes, int] = {}
        self.add_frame(FrameRole.REQUEST, call.request)
        for role, seen in call.other_frames:
            self.add_frame(role, seen)
        if call.reply is not None:
            self.add_frame(FrameRole.REPLY, call.reply)

    def add_frame(self, role: FrameRole, observation: FrameObservation) -> None:
        frame = observation.item
        if role in (FrameRole.REQUEST, FrameRole.RETRY):
            self.sent_at[frame.raw] = observation.time
            self.reserved_by_serial[frame.serial] = frame.reserved
        elif role in _REPLIES and not (
            isinstance(observation, JoinedObservation) and observation.was_lost_between
        ):
            self.received_at[frame.raw] = observation.time


class FrameIndexes(dict[Call, FrameIndex]):
    def __missing__(self, call: Call) -> FrameIndex:
        index = self[call] = FrameIndex(call)
        return index
