"""Decode several captures. Some of them hold the same conversation, captured at different places."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import chain
from operator import itemgetter
from typing import NamedTuple

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.capture_sequence import CaptureSequence, PacketOrigin
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import COMMENTS_LIMIT, PacketDecoder, ignore_packet
from bcapscope.capture.place_plan import PlaceFile, PlacePlan
from bcapscope.traffic.joining.clock_estimate import ClockEstimate
from bcapscope.traffic.joining.frame_sample import ConversationEnds, ends_of
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import CapturedTwins, CaptureSide, Coverage
from bcapscope.traffic.observation import Conversation, Observation

OpenSequence = Callable[[Sequence[str]], CaptureSequence]
"""Function that opens several files, to be read as one sequence. If a file cannot be read, the sequence
reports the error to the user.
"""


class PlaceDecoder:
    """Turns the packets of several captures into observations, in chronological order.

    If two captures hold the same conversation, the conversation gets a `capture_side` in each capture. A
    `Joiner` joins the observations by their `capture_side`. Times from the capture at the controller's side
    are converted to the clock of the capture at the client's side. Packets are numbered over all files: first
    files captured at the client's side, then files captured at the controller's side, then all other files.

    Attributes:
        note_packet: Function that receives frame and packet numbers, as in `PacketDecoder`.
        comments: Comments of the latest packets that have comments; the key is the packet number.
    """

    def __init__(
        self,
        paths: Sequence[str],
        plans: Sequence[PlacePlan],
        ports: Collection[int],
        open_sequence: OpenSequence,
    ) -> None:
        self.comments: dict[int, tuple[str, ...]] = {}
        self.note_packet: Callable[[int, int], object] = ignore_packet
        self._sources: list[_Source] = []
        planned: list[PlaceFile] = []
        for group in _grouped(plans):
            sides = _sides_of(group)
            for place in CapturePlace:
                base = sum(file.packets for file in planned)
                parts = [_part(plan, place, open_sequence) for plan in group]
                self._sources.append(_Source(PacketDecoder(ports), parts, base, sides[place]))
                planned += [plan.files[place] for plan in group]
        rest = [path for path in paths if path not in {file.path for file in planned}]
        if rest:
            base = sum(file.packets for file in planned)
            self._sources.append(_Source(PacketDecoder(ports), [_Part(open_sequence(rest))], base, {}))

    @property
    def counts(self) -> CaptureCounts:
        """Numbers of packets and observations of all captures so far."""
        total = CaptureCounts()
        for each in fields(CaptureCounts):
            values = [getattr(source.decoder.counts, each.name) for source in self._sources]
            is_counter = isinstance(values[0], Counter)
            setattr(total, each.name, sum(values, Counter() if is_counter else 0))
        return total

    @property
    def conversations(self) -> tuple[Conversation, ...]:
        return tuple(each for source in self._sources for each in source.decoder.conversations)

    @property
    def end_time(self) -> int:
        return max(source.decoder.end_time for source in self._sources)

    @property
    def paths(self) -> Sequence[str]:
        """Paths of all captures. Captures that are named in the plans come first."""
        return [path for sequence in self._sequences() for path in sequence.paths]

    @property
    def position(self) -> int:
        """Number of bytes read so far."""
        return sum(sequence.position for sequence in self._sequences())

    @property
    def size(self) -> int | None:
        """Size of all files in bytes; None if it is not known."""
        sizes = [sequence.size for sequence in self._sequences()]
        return None if None in sizes else sum(size or 0 for size in sizes)

    def origin_of(self, packet: int) -> PacketOrigin | None:
        """Return the capture that holds a packet, and the packet's number there; None if not known."""
        source = next(each for each in reversed(self._sources) if each.base < packet or not each.base)
        return source.origin_of(packet - source.base)

    def _sequences(self) -> Iterator[CaptureSequence]:
        return (part.sequence for source in self._sources for part in source.parts)

    def observations(self) -> Iterator[Observation]:
        """Yield the observations of all captures.

        Raises:
            CaptureError: The function that reads the packets raised this error.
        """
        streams = [source.timed_observations(self._keep_comments) for source in self._sources]
        merged: Iterable[tuple[int, Observation]] = heapq.merge(*streams, key=itemgetter(0))
        note = self.note_packet
        for number, (_, observation) in enumerate(merged, 1):
            note(number, observation.packet)
            yield observation._replace(number=number)

    def _keep_comments(self, packet: int, comments: tuple[str, ...]) -> None:
        self.comments[packet] = comments
        if len(self.comments) > COMMENTS_LIMIT:
            del self.comments[next(iter(self.comments))]


class _Part(NamedTuple):
    """Files that one decoder reads. The times of the files are converted from `clock` to the clock at the
    client's side.

    `packets` is the number of packets in the files; 0 for the last part, because this number is not needed.
    """

    sequence: CaptureSequence
    clock: ClockEstimate | None = None
    packets: int = 0

    def timed_packets(self) -> Iterator[Packet]:
        if self.clock is None:
            yield from self.sequence
            return
        convert = self.clock.to_client_clock
        for time, data, length, interface, comments in self.sequence:
            yield convert(time), data, length, interface, comments


class _Source:
    """The groups of files (`_Part`) that one decoder reads one after another."""

    def __init__(
        self,
        decoder: PacketDecoder,
        parts: Sequence[_Part],
        base: int,
        sides: dict[ConversationEnds, CaptureSide],
    ) -> None:
        self.decoder = decoder
        self.parts = parts
        self.base = base
        self._sides = sides
        self._known: set[Conversation] = set()

    def origin_of(self, packet: int) -> PacketOrigin | None:
        """Return the capture that holds a packet of this source, and the packet's number there."""
        *first, last = self.parts
        for part in first:
            if packet <= part.packets:
                return part.sequence.origin_of(packet)
            packet -= part.packets
        return last.sequence.origin_of(packet)

    def timed_observations(
        self, keep_comments: Callable[[int, tuple[str, ...]], object]
    ) -> Iterator[tuple[int, Observation]]:
        """Yield the observations with their times. The packets of all sources are numbered together."""
        comments, base = self.decoder.comments, self.base
        packets = chain.from_iterable(part.timed_packets() for part in self.parts)
        for observation in self.decoder.decode(packets):
            conversation = observation.flow.conversation
            if conversation not in self._known:
                self._known.add(conversation)
                conversation.capture_side = self._sides.get(ends_of(conversation))
            if comments and observation.packet in comments:
                keep_comments(base + observation.packet, comments[observation.packet])
            yield observation.time, observation._replace(packet=base + observation.packet)


def _part(plan: PlacePlan, place: CapturePlace, open_sequence: OpenSequence) -> _Part:
    file = plan.files[place]
    clock = plan.clock if place is CapturePlace.CONTROLLER_SIDE else None
    return _Part(open_sequence([file.path]), clock, file.packets)


def _grouped(plans: Sequence[PlacePlan]) -> list[list[PlacePlan]]:
    """Group the plans that have conversations in common. An example is the plans for the files of two ring
    recordings. Each group is in chronological order.
    """
    groups: list[list[PlacePlan]] = []
    for plan in sorted(plans, key=lambda each: each.files[0].begins):
        group = next((each for each in groups if not set(each[0].shared).isdisjoint(plan.shared)), None)
        if group is None:
            groups.append([plan])
        else:
            group.append(plan)
    return groups


def _sides_of(group: Sequence[PlacePlan]) -> tuple[dict[ConversationEnds, CaptureSide], ...]:
    """For each place, return the shared conversations. The keys are the ends of a conversation as captured at
    this place.
    """
    coverage = (
        Coverage(min(plan.files[0].begins for plan in group), max(plan.files[0].ends for plan in group)),
        Coverage(
            min(plan.clock.to_client_clock(plan.files[1].begins) for plan in group),
            max(plan.clock.to_client_clock(plan.files[1].ends) for plan in group),
        ),
    )
    error = max(plan.clock.error for plan in group)
    sides: tuple[dict[ConversationEnds, CaptureSide], ...] = ({}, {})
    for ends in dict.fromkeys(ends for plan in group for ends in plan.shared):
        twins = CapturedTwins(coverage, error, is_relayed=ends[0][1] != ends[1][1])
        for place in CapturePlace:
            sides[place][ends[place]] = CaptureSide(twins, place)
    return sides
