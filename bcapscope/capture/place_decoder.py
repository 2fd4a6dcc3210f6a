"""Decode several captures, of which some hold the same conversation, each from another place."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import fields
from operator import itemgetter

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.capture_sequence import CaptureSequence, PacketOrigin
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import COMMENTS_LIMIT, PacketDecoder
from bcapscope.capture.place_plan import PlacePlan
from bcapscope.traffic.joining.captured_twins import CapturedTwins, CaptureSide
from bcapscope.traffic.joining.clock_estimate import ClockEstimate
from bcapscope.traffic.joining.frame_sample import ConversationEnds, ends_of
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.joining.place_merger import Coverage
from bcapscope.traffic.observation import Conversation, Observation

OpenSequence = Callable[[Sequence[str]], CaptureSequence]
"""Function that returns the sequence of some files, which keeps read errors for the user."""


class PlaceDecoder:
    """Turns the packets of several captures into observations, in order of time.

    Conversations that two captures hold get a `capture_side`, by which a `Joiner` joins them. Their times are
    by the clock of the capture at the client's side. Packets are counted over all files: first the files of
    the plans, then the others.

    Attributes:
        comments: Comments by packet number, for the latest packets with comments.
    """

    def __init__(
        self,
        paths: Sequence[str],
        plans: Sequence[PlacePlan],
        ports: Collection[int],
        open_sequence: OpenSequence,
    ) -> None:
        self.comments: dict[int, tuple[str, ...]] = {}
        self._sources: list[_Source] = []
        base = 0
        for plan in plans:
            sides = _sides_of(plan)
            for place, file in zip(CapturePlace, plan.files, strict=True):
                clock = plan.clock if place is CapturePlace.CONTROLLER_SIDE else None
                sequence = open_sequence([file.path])
                self._sources.append(_Source(PacketDecoder(ports), sequence, base, sides[place], clock))
                base += file.packets
        planned = {file.path for plan in plans for file in plan.files}
        rest = [path for path in paths if path not in planned]
        if rest:
            self._sources.append(_Source(PacketDecoder(ports), open_sequence(rest), base, {}))

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
        """Paths of the captures: first those of the plans."""
        return [path for source in self._sources for path in source.sequence.paths]

    @property
    def position(self) -> int:
        """Number of bytes read so far."""
        return sum(source.sequence.position for source in self._sources)

    @property
    def size(self) -> int | None:
        """Size of all files in bytes; None if it is not known."""
        sizes = [source.sequence.size for source in self._sources]
        return None if None in sizes else sum(size or 0 for size in sizes)

    def origin_of(self, packet: int) -> PacketOrigin | None:
        """Return where a packet is found, by its number among all packets; None if it is not known."""
        source = next(each for each in reversed(self._sources) if each.base < packet or not each.base)
        return source.sequence.origin_of(packet - source.base)

    def observations(self) -> Iterator[Observation]:
        """Yield the observations of all captures.

        Raises:
            CaptureError: The function that reads the packets raised it.
        """
        streams = [source.timed_observations(self._keep_comments) for source in self._sources]
        merged: Iterable[tuple[int, Observation]] = heapq.merge(*streams, key=itemgetter(0))
        for number, (_, observation) in enumerate(merged, 1):
            yield observation._replace(number=number)

    def _keep_comments(self, packet: int, comments: tuple[str, ...]) -> None:
        self.comments[packet] = comments
        if len(self.comments) > COMMENTS_LIMIT:
            del self.comments[next(iter(self.comments))]


class _Source:
    """The files that one decoder reads one after another."""

    def __init__(
        self,
        decoder: PacketDecoder,
        sequence: CaptureSequence,
        base: int,
        sides: dict[ConversationEnds, CaptureSide],
        clock: ClockEstimate | None = None,
    ) -> None:
        self.decoder = decoder
        self.sequence = sequence
        self.base = base
        self._sides = sides
        self._clock = clock
        self._known: set[Conversation] = set()

    def timed_observations(
        self, keep_comments: Callable[[int, tuple[str, ...]], object]
    ) -> Iterator[tuple[int, Observation]]:
        """Yield the observations with their times, numbered by packets of all sources."""
        comments, base = self.decoder.comments, self.base
        for observation in self.decoder.decode(_by_client_clock(self.sequence, self._clock)):
            conversation = observation.flow.conversation
            if conversation not in self._known:
                self._known.add(conversation)
                conversation.capture_side = self._sides.get(ends_of(conversation))
            if comments and observation.packet in comments:
                keep_comments(base + observation.packet, comments[observation.packet])
            yield observation.time, observation._replace(packet=base + observation.packet)


def _sides_of(plan: PlacePlan) -> tuple[dict[ConversationEnds, CaptureSide], ...]:
    """Return the shared conversations at each place, by their ends."""
    near, far = plan.files
    convert = plan.clock.to_client_clock
    coverage = Coverage(near.begins, near.ends), Coverage(convert(far.begins), convert(far.ends))
    sides: tuple[dict[ConversationEnds, CaptureSide], ...] = ({}, {})
    for ends in plan.shared:
        is_relayed = ends[0][1] != ends[1][1]
        twins = CapturedTwins(coverage, plan.clock.error, is_relayed=is_relayed)
        for place in CapturePlace:
            sides[place][ends[place]] = CaptureSide(twins, place)
    return sides


def _by_client_clock(packets: Iterable[Packet], clock: ClockEstimate | None) -> Iterator[Packet]:
    for packet in packets:
        yield packet if clock is None else (clock.to_client_clock(packet[0]), *packet[1:])
