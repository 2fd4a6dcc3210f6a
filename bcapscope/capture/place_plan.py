"""Find out which capture files hold the same conversation, and how their clocks differ."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, combinations, islice
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
"""Maximum number of packets of any protocol that are read for a sample."""

MAX_FILES = 100
"""Maximum number of files that are compared. More files are probably a ring; comparing them takes long."""

FEWEST_JOINED = 2
"""Minimum number of equal frames of a conversation in two files that are joined."""


@dataclass(slots=True)
class PlaceFile:
    """A capture file that was taken at one of two places.

    Attributes:
        begins: Time of the first packet, by the clock of this file, ns since 1970.
        ends: Time of the last packet.
        packets: Number of packets.
    """

    path: str
    begins: int = 0
    ends: int = 0
    packets: int = 0


@dataclass(slots=True)
class PlacePlan:
    """Two capture files that hold the same conversations.

    Attributes:
        files: File from the client's side, and file from the controller's side.
        clock: How far the clock of the second file is ahead of the clock of the first.
        shared: Ends of each shared conversation, at the client's and at the controller's side.
    """

    files: tuple[PlaceFile, PlaceFile]
    clock: ClockEstimate
    shared: list[tuple[ConversationEnds, ConversationEnds]] = field(default_factory=list)


def plan_places(paths: Sequence[str], ports: Collection[int]) -> list[PlacePlan]:
    """Return the pairs of files that hold the same conversation. A file is in one pair at most.

    Files that cannot be read are in no pair. Reading them again reports why.
    A pipe is in no pair, because it can be read only once.
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
    """The beginning of a file. `begins` is the time of its first packet, ns since 1970; 0 without packets."""

    def __init__(self, path: str, ports: Collection[int]) -> None:
        self.path = path
        self.frames = FrameSample()
        self._ports = ports
        packets = self._packets()
        first = next(packets, None)
        self.begins = 0 if first is None else first[0]
        if first is not None:
            self._read_frames(self.frames, chain((first,), packets))

    @cached_property
    def ends(self) -> int:
        """Time of the last packet, ns since 1970. All packets are read to find it."""
        return max((packet[0] for packet in self._packets()), default=0)

    def frames_from(self, begin: int) -> FrameSample:
        """Return a sample of the frames from the time `begin` on."""
        frames = FrameSample()
        self._read_frames(frames, (packet for packet in self._packets() if packet[0] >= begin))
        return frames

    def _packets(self) -> Iterator[Packet]:
        with suppress(CaptureError), open_capture(self.path) as capture:
            yield from capture

    def _read_frames(self, frames: FrameSample, packets: Iterable[Packet]) -> None:
        for observation in PacketDecoder(self._ports).decode(islice(packets, SAMPLE_PACKETS)):
            frames.add(observation)
            if frames.count >= SAMPLE_FRAMES:
                break


def _plan_pair(one: _Sample, other: _Sample, ports: Collection[int]) -> PlacePlan | None:
    shared = find_shared(one.frames, other.frames)
    if not shared and _has_common_ends(one.frames, other.frames):
        shared = _find_later(one, other)
    if not shared:
        return None
    first = max(shared, key=lambda each: each.request_offset is not None and each.reply_offset is not None)
    files = PlaceFile(one.path), PlaceFile(other.path)
    if not _is_at_client(first):
        first, files = _reversed(first), (files[1], files[0])
    measurement = _Measurement(files, first.offset, ports)
    clock = measurement.measure()
    if clock is None or not measurement.shared or not (first.is_sure or _overlap(*files)):
        return None
    return PlacePlan(files, clock, measurement.shared)


def _has_common_ends(one: FrameSample, other: FrameSample) -> bool:
    return not one.frames.keys().isdisjoint(other.frames)


def _find_later(one: _Sample, other: _Sample) -> list[SharedConversation]:
    """Return the shared conversations of two files, of which one begins much later than the other."""
    if one.begins <= other.begins:
        return find_shared(_frames_at(one, other.begins), other.frames)
    return find_shared(one.frames, _frames_at(other, one.begins))


def _frames_at(sample: _Sample, begin: int) -> FrameSample:
    """Return the frames of a file around the time `begin` at which the other file begins.

    Files of a ring follow each other. They are not searched again for each other file of the ring.
    """
    return sample.frames_from(begin - JOIN_WITHIN_NS) if begin <= sample.ends else FrameSample()


def _overlap(one: PlaceFile, other: PlaceFile) -> bool:
    """Return whether two files were captured at the same time, each by its own clock."""
    return one.begins <= other.ends and other.begins <= one.ends


def _is_at_client(shared: SharedConversation) -> bool:
    """Return whether the first of two captures was taken nearer to the client.

    Nearer to the client, requests are captured earlier and replies later. Between the clocks, only the
    difference of both shows.
    """
    if shared.request_offset is None or shared.reply_offset is None:
        return True
    return shared.request_offset >= shared.reply_offset


def _reversed(shared: SharedConversation) -> SharedConversation:
    ends, request, reply = shared.ends, shared.request_offset, shared.reply_offset
    return shared._replace(
        ends=(ends[1], ends[0]),
        offset=-shared.offset,
        request_offset=None if request is None else -request,
        reply_offset=None if reply is None else -reply,
    )


class _Measurement:
    """Reads two files to their ends, and finds the frames that both hold."""

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
        self.shared = [ends for ends, count in self._joined.items() if count >= FEWEST_JOINED]
        return self._estimator.estimate()

    def _timed(self, place: CapturePlace) -> Iterator[tuple[int, CapturePlace, Observation]]:
        """Yield the observations of a file with their rough times by the client's clock."""
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
        self._offset = far.time - near.time  # so that a drift over many hours does no harm
        self._estimator.add_frame(near.time, far.time, is_request=key[0] is Direction.REQUEST)
        ends = ends_of(near.flow.conversation), ends_of(far.flow.conversation)
        self._joined[ends] = self._joined.get(ends, 0) + 1

    @staticmethod
    def _drop_old(waiting: dict[tuple[Direction, bytes], Observation], now: int) -> None:
        """Forget the frames that the other place did not capture in time."""
        while waiting:
            oldest = next(iter(waiting))
            if waiting[oldest].time + JOIN_WITHIN_NS >= now:
                break
            del waiting[oldest]


def _counted(packets: Iterable[Packet], file: PlaceFile) -> Iterator[Packet]:
    """Yield packets, and note in `file` how many there are and when they were captured."""
    for packet in packets:
        file.packets += 1
        file.begins = file.begins or packet[0]
        file.ends = max(file.ends, packet[0])
        yield packet
