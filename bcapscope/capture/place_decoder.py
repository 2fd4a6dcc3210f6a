"""Decode several captures. Two captures of the same conversation can come from different places."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from operator import itemgetter

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.capture_sequence import CaptureSequence
from bcapscope.capture.packet import PacketOrigin
from bcapscope.capture.packet_decoder import PacketComments, PacketDecoder
from bcapscope.capture.place_plan import PlacePlan
from bcapscope.traffic.joining.frame_sample import ConversationEnds, ends_of
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import CapturedTwins, CaptureSide, Coverage
from bcapscope.traffic.observation import Conversation, Observation


class PlaceDecoder:
    """Turns the packets of several captures into observations, in chronological order.

    If two captures hold the same conversation, the conversation gets a `capture_side` in each capture. A
    `Joiner` then joins the observations. Times from the controller's side are converted to the clock at the
    client's side. Packets are numbered over all files. Of captures that share a conversation, the client's
    side comes first. All other files come last.

    Attributes:
        note_packet: Receives frame and packet numbers, as in `PacketDecoder`.
    """

    def __init__(
        self,
        paths: Sequence[str],
        plans: Sequence[PlacePlan],
        ports: Collection[int],
        open_sequence: Callable[..., CaptureSequence],
    ) -> None:
        self.comments = PacketComments()
        self.note_packet: Callable[[int, int], object] = lambda frame, packet: None
        self._sources: list[_Source] = []
        base = 0
        for group in _grouped(plans):
            sides = _sides_of(group)
            for place in CapturePlace:
                clocks = {plan.files[place].path: plan.clock for plan in group}
                is_converted = place is CapturePlace.CONTROLLER_SIDE
                sequence = open_sequence(list(clocks), clocks=clocks if is_converted else {})
                self._sources.append(_Source(PacketDecoder(ports), sequence, base, sides[place]))
                base += sum(plan.files[place].packets for plan in group)
        planned = {file.path for plan in plans for file in plan.files}
        rest = [path for path in paths if path not in planned]
        if rest:
            self._sources.append(_Source(PacketDecoder(ports), open_sequence(rest), base, {}))

    @property
    def counts(self) -> CaptureCounts:
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
        """Paths of all captures: first those with a shared conversation, then the others."""
        return [path for source in self._sources for path in source.sequence.paths]

    @property
    def position(self) -> int:
        return sum(source.sequence.position for source in self._sources)

    @property
    def size(self) -> int | None:
        sizes = [source.sequence.size for source in self._sources]
        return None if None in sizes else sum(size or 0 for size in sizes)

    def origin_of(self, packet: int) -> PacketOrigin | None:
        source = next(each for each in reversed(self._sources) if each.base < packet or not each.base)
        return source.sequence.origin_of(packet - source.base)

    def observations(self) -> Iterator[Observation]:
        streams = [source.timed_observations(self.comments) for source in self._sources]
        merged: Iterable[tuple[int, Observation]] = heapq.merge(*streams, key=itemgetter(0))
        note = self.note_packet
        for number, (_, observation) in enumerate(merged, 1):
            note(number, observation.packet)
            yield observation._replace(number=number)


@dataclass(slots=True)
class _Source:
    """The captures that one `PacketDecoder` reads. `base` is the number of packets in all earlier sources."""

    decoder: PacketDecoder
    sequence: CaptureSequence
    base: int
    sides: dict[ConversationEnds, CaptureSide]
    _known: set[Conversation] = field(default_factory=set)

    def timed_observations(self, kept: PacketComments) -> Iterator[tuple[int, Observation]]:
        comments, base = self.decoder.comments, self.base
        for observation in self.decoder.decode(self.sequence):
            conversation = observation.flow.conversation
            if conversation not in self._known:
                self._known.add(conversation)
                conversation.capture_side = self.sides.get(ends_of(conversation))
            packet = base + observation.packet
            if comments and observation.packet in comments and packet not in kept:
                kept.add(packet, comments[observation.packet])
            yield observation.time, observation._replace(packet=packet)


def _grouped(plans: Sequence[PlacePlan]) -> list[list[PlacePlan]]:
    """Group plans that share conversations, in chronological order. A plan holds one pair of files. Two
    recordings that each consist of several files therefore have several plans.
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
    """For each side, return a `CaptureSide` for each shared conversation. The key is the pair of addresses
    that this side captured.
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
        twins = CapturedTwins(coverage, error, ends[0][1] != ends[1][1], ends[0])
        for place in CapturePlace:
            sides[place][ends[place]] = CaptureSide(twins, place)
    return sides
