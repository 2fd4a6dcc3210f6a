"""Compare samples of frames to recognise whether two captures hold the same conversation."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median
from typing import NamedTuple, TypeAlias

from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Observation, Transport

SAMPLE_FRAMES = 2048
"""Maximum number of frames in a sample: 8 s at a cycle time of 8 ms and two frames per cycle."""

FEWEST_SHARED = 4
"""Minimum number of frames that two samples of the same conversation have in common."""

_SAME_OFFSET_NS = 500_000_000
"""Maximum difference in ns between the time offset of one frame and the median time offset of all common
frames. The time offset is the time from the frame in the first capture to the frame with equal bytes in the
second capture. If the difference is larger, the two are different frames, such as polls with a reused serial.
"""

SURE_FRAMES, SURE_SHARE, SURE_SPREAD_NS = 40, 0.8, 2_000_000
"""Conditions for joining two captures whose times do not overlap, because one clock was wrong: the minimum
number of common frames, their minimum fraction of the smaller sample, and the maximum median deviation from
the median time offset in ns. Two captures may also hold two executions of one program. Such captures do not
normally meet the conditions, because the port, the values or the pauses of the two executions differ.
"""

ConversationEnds: TypeAlias = tuple[Endpoint, Endpoint, Transport]
"""Client, controller and transport."""

_FrameKey: TypeAlias = tuple[Direction, bytes]


class SharedConversation(NamedTuple):
    """A conversation that two captures hold.

    Attributes:
        ends: The ends in the first and in the second capture. They differ if a proxy or router is between.
        offset: Median time in ns from a frame in the first capture to the same frame in the second capture.
        request_offset: Offset measured on requests only; None if the captures have no request in common.
        is_sure: Whether the captures may be joined even if their times do not overlap.
    """

    ends: tuple[ConversationEnds, ConversationEnds]
    offset: int
    request_offset: int | None
    reply_offset: int | None
    is_sure: bool


class FrameSample:
    """A sample of the frames of one capture, each with the time at which it first occurred."""

    def __init__(self) -> None:
        self.count = 0
        self.frames: dict[ConversationEnds, dict[_FrameKey, int]] = {}

    def add(self, observation: Observation) -> None:
        frames = self.frames.setdefault(ends_of(observation.flow.conversation), {})
        frames.setdefault((observation.flow.direction, observation.item.raw), observation.time)
        self.count += 1


def ends_of(conversation: Conversation) -> ConversationEnds:
    return conversation.client, conversation.server, conversation.transport


def find_shared(one: FrameSample, other: FrameSample) -> list[SharedConversation]:
    found = (
        _compare((ends, other_ends), frames, other_frames)
        for ends, frames in one.frames.items()
        for other_ends, other_frames in other.frames.items()
        if ends[2] is other_ends[2]
    )
    return [each for each in found if each is not None]


def _compare(
    ends: tuple[ConversationEnds, ConversationEnds],
    frames: dict[_FrameKey, int],
    other_frames: dict[_FrameKey, int],
) -> SharedConversation | None:
    offsets = {
        key: other_frames[key] - time for key, time in frames.items() if key in other_frames and key[1]
    }
    if len(offsets) < FEWEST_SHARED:
        return None
    offset = _middle(offsets.values())
    same = {key: each for key, each in offsets.items() if abs(each - offset) <= _SAME_OFFSET_NS}
    if len(same) < FEWEST_SHARED or 2 * len(same) < len(offsets):
        return None
    requests, replies = (
        [each for (direction, _), each in same.items() if direction is wanted] for wanted in Direction
    )
    spread = _middle(abs(each - offset) for each in same.values())
    fewest = max(SURE_FRAMES, round(SURE_SHARE * min(len(frames), len(other_frames))))
    return SharedConversation(
        ends,
        offset,
        _middle(requests) if requests else None,
        _middle(replies) if replies else None,
        is_sure=ends[0] == ends[1] and len(same) >= fewest and spread <= SURE_SPREAD_NS,
    )


def _middle(values: Iterable[int]) -> int:
    return round(median(values))
