"""Find out which capture files hold the same conversation, and how their clocks differ."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, islice
from pathlib import Path

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from bcapscope.traffic.joining.clock_estimate import ClockEstimate, ClockEstimator
from bcapscope.traffic.joining.frame_sample import (
    SAMPLE_FRAMES,
    ConversationEnds,
    FrameSample,
    SharedConversation,
    ends_of,
    find_shared,
)
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import JOIN_WITHIN_NS
from bcapscope.traffic.observation import Direction, Observation

SAMPLE_PACKETS = 20_000
"""Maximum number of packets, of all protocols, to compare per file."""

MAX_FILES = 100
"""Maximum number of files to compare. If there are more files, none are compared, to save time."""

FEWEST_JOINED = 2
"""A conversation in two files is joined only if both files hold at least this many equal frames."""


@dataclass(slots=True)
class PlaceFile:
    """A capture file taken at one of two places. Times are by the file's own clock, ns since 1970."""

    path: str
    begins: int = 0
    ends: int = 0
    packets: int = 0


@dataclass(slots=True)
class PlacePlan:
    """Two capture files that hold the same conversations.

    Attributes:
        files: File captured at the client's side, and file captured at the controller's side.
        clock: How far the clock of the second file is ahead of the clock of the first.
        shared: For each conversation in both files, the addresses at the client's side and at the
            controller's side.
    """

    files: tuple[PlaceFile, PlaceFile]
    clock: ClockEstimate
    shared: list[tuple[ConversationEnds, ConversationEnds]] = field(default_factory=list)


def plan_places(paths: Sequence[str], ports: Collection[int]) -> list[PlacePlan]:
    """Find pairs of files that hold the same conversation. Each file belongs to at most one pair.

    Files that cannot be read are ignored here, because the decoder reports them later. Pipes are ignored,
    because they can be read only once.
    """
    files = [path for path in dict.fromkeys(paths) if Path(path).is_file()]
    samples = {path: _Sample(path, ports) for path in files} if len(files) <= MAX_FILES else {}
    plans: list[PlacePlan] = []
    paired: set[str] = set()
    for one, other in combinations(samples, 2):
        if paired & {one, other}:
            continue
        plan = _plan_pair(samples[one], samples[other], ports)
        if plan is not None:
            plans.append(plan)
            paired |= {one, other}
    return plans


class _Sample:
    """The first frames of a file at or after the time `begin`."""

    def __init__(self, path: str, ports: Collection[int], begin: int = 0) -> None:
        self.path = path
        self.frames = FrameSample()
        start = PlaceFile(path)
        with suppress(CaptureError), open_capture(path) as capture:
            packets = islice((packet for packet in capture if packet[0] >= begin), SAMPLE_PACKETS)
            for observation in PacketDecoder(ports).decode(_counted(packets, start)):
                self.frames.add(observation)
                if self.frames.count >= SAMPLE_FRAMES:
                    break
        self.begins = start.begins

    @cached_property
    def ends(self) -> int:
        file = PlaceFile(self.path)
        with suppress(CaptureError), open_capture(self.path) as capture:
            deque(_counted(capture, file), maxlen=0)
        return file.ends


def _plan_pair(one: _Sample, other: _Sample, ports: Collection[int]) -> PlacePlan | None:
    shared = find_shared(one.frames, other.frames)
    if not shared and not one.frames.frames.keys().isdisjoint(other.frames.frames):
        shared = _find_later(one, other, ports)
    if not shared:
        return None
    first = max(shared, key=lambda each: each.request_offset is not None and each.reply_offset is not None)
    files = PlaceFile(one.path), PlaceFile(other.path)
    offset = first.offset
    if not _is_at_client(first):
        offset, files = -offset, (files[1], files[0])
    measurement = _Measurement(files, offset, ports)
    clock = measurement.measure()
    if clock is None or not measurement.shared or not (first.is_sure or _overlap(*files)):
        return None
    return PlacePlan(files, clock, measurement.shared)


def _find_later(one: _Sample, other: _Sample, ports: Collection[int]) -> list[SharedConversation]:
    """Compare the beginning of the later file with packets from the middle of the earlier file."""
    earlier, later = (one, other) if one.begins <= other.begins else (other, one)
    if earlier.ends < later.begins:
        return []
    middle = _Sample(earlier.path, ports, later.begins - JOIN_WITHIN_NS)
    return find_shared(*((middle.frames, other.frames) if earlier is one else (one.frames, middle.frames)))


def _overlap(one: PlaceFile, other: PlaceFile) -> bool:
    return one.begins <= other.ends and other.begins <= one.ends


def _is_at_client(shared: SharedConversation) -> bool:
    """Return whether the first of two captures was taken nearer to the client. A capture nearer to the client
    sees requests earlier and replies later. A difference of the clocks shifts `request_offset` and
    `reply_offset` equally, so the comparison of the two offsets cancels it.
    """
    if shared.request_offset is None or shared.reply_offset is None:
        return True
    return shared.request_offset >= shared.reply_offset


class _Measurement:
    def __init__(self, files: tuple[PlaceFile, PlaceFile], offset: int, ports: Collection[int]) -> None:
        self.shared: list[tuple[ConversationEnds, ConversationEnds]] = []
        self._files = files
        self._offset = offset
        self._ports = ports
        self._estimator = ClockEstimator()
        self._waiting: tuple[dict[tuple[Direction, bytes], Observation], ...] = ({}, {})
        self._joined: dict[tuple[ConversationEnds, ConversationEnds], int] = {}

    def measure(self) -> ClockEstimate | None:
        merged: Iterable[tuple[int, CapturePlace, Observation]] = heapq.merge(
            *(self._timed(place) for place in CapturePlace), key=lambda each: each[0]
        )
        for time, place, observation in merged:
            self._add(time, place, observation)
        self._choose_shared()
        return self._estimator.estimate()

    def _choose_shared(self) -> None:
        """Pair each conversation with at most one conversation of the other file. Prefer pairs with the same
        addresses and ports, then pairs with many equal frames.
        """
        taken: set[tuple[CapturePlace, ConversationEnds]] = set()
        for ends in sorted(self._joined, key=lambda each: (each[0] != each[1], -self._joined[each])):
            own = set(zip(CapturePlace, ends, strict=True))
            if self._joined[ends] >= FEWEST_JOINED and not taken & own:
                taken |= own
                self.shared.append(ends)

    def _timed(self, place: CapturePlace) -> Iterator[tuple[int, CapturePlace, Observation]]:
        """Yield a file's observations, with approximate times by the clock at the client's side."""
        file = self._files[place]
        with suppress(CaptureError), open_capture(file.path) as capture:
            for observation in PacketDecoder(self._ports).decode(_counted(capture, file)):
                time = observation.time
                yield (time if place is CapturePlace.CLIENT_SIDE else time - self._offset), place, observation

    def _add(self, time: int, place: CapturePlace, observation: Observation) -> None:
        key = observation.flow.direction, observation.item.raw
        twin = self._waiting[1 - place].pop(key, None)
        if twin is None:
            waiting = self._waiting[place]
            waiting.pop(key, None)
            waiting[key] = observation
            self._drop_old(waiting, observation.time)
            return
        near, far = (observation, twin) if place is CapturePlace.CLIENT_SIDE else (twin, observation)
        # updated with each frame, to follow the drift of the clocks over many hours
        self._offset = far.time - near.time
        self._estimator.add_frame(near.time, far.time, is_request=key[0] is Direction.REQUEST)
        ends = ends_of(near.flow.conversation), ends_of(far.flow.conversation)
        self._joined[ends] = self._joined.get(ends, 0) + 1

    @staticmethod
    def _drop_old(waiting: dict[tuple[Direction, bytes], Observation], now: int) -> None:
        while waiting:
            oldest = next(iter(waiting))
            if waiting[oldest].time + JOIN_WITHIN_NS >= now:
                break
            del waiting[oldest]


def _counted(packets: Iterable[Packet], file: PlaceFile) -> Iterator[Packet]:
    for packet in packets:
        file.packets += 1
        file.begins = file.begins or packet[0]
        file.ends = max(file.ends, packet[0])
        yield packet
