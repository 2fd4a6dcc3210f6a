"""Decodes the records in the relay's ring into observations: the requests and replies of each client.

Observations show the client's side: requests as received by the proxy, even if a rule dropped them, and
replies as sent to the client. For a client, observations of the controller's side begin when the proxy
changes, delays or drops a message of the client's conversation.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from itertools import repeat
from operator import itemgetter
from typing import TypeAlias

from bcapscope.messages import Message
from bcapscope.messages.message_codec import decode_message
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, Malformed, parse_captured_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import StreamPiece, StreamSplitter
from bcapscope.proxy.relay_session import ClientEndpoints, read_endpoints
from bcapscope.proxy.ring_buffer import RingRecord, RingRecordKind, hole_sizes
from bcapscope.traffic.joining.leg_joiner import RelayedObservation
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)

NotedObservation: TypeAlias = tuple[Observation, Message | None]
"""An observation, and what a proxy rule did to the message; None if no rule affected the message. Only
observations of the client's side are numbered, so observations of the controller's side have the number 0.
"""

_offset = itemgetter(0)

_MAX_MARKS = 256
"""Maximum number of arrival times that the decoder keeps of an unfinished frame."""


class _DirectionStream:
    """One direction of a client's conversation.

    Attributes:
        arrival_times: Offsets in the stream, each with the time in ns of the bytes that start there.
        packet: Number of the last packet of the stream in the recording; 0 if the recording has none.
        is_near: Whether the stream is on the client's side.
        is_joined: Whether the decoder also decodes this direction on the other side of the proxy.
    """

    def __init__(self, flow: Flow, splitter: StreamSplitter, *, is_near: bool = True) -> None:
        self.flow = flow
        self.splitter = splitter
        self.is_near = is_near
        self.is_joined = not is_near
        self.size = self.packet = 0
        self.arrival_times: list[tuple[int, int]] = []


class _Client:
    """A client. `streams[True]` lists the streams of requests, and `streams[False]` the streams of replies. A
    list has one stream, on the client's side, or a stream on each side of the proxy. If a list has two
    streams, the stream on the sender's side comes first.
    """

    def __init__(
        self, endpoints: ClientEndpoints, received_at: int, budget: ByteBudget, templates: FrameTemplates
    ) -> None:
        self.last_heard = received_at
        self.is_stream = endpoints.transport is Transport.TCP
        self.decodes_far_side = False
        self._endpoints = endpoints
        self._budget, self._templates = budget, templates
        self.streams: dict[bool, list[_DirectionStream]] = {False: [], True: []}
        self.conversation = self._add_streams(endpoints.client, is_near=True)

    @property
    def is_between_frames(self) -> bool:
        return not any(stream.splitter.pending_bytes for side in self.streams.values() for stream in side)

    def decode_far_side(self) -> Conversation:
        """Return the conversation between proxy and controller."""
        self.decodes_far_side = True
        for (near,) in self.streams.values():
            near.is_joined = True
        return self._add_streams(self._endpoints.upstream, is_near=False)

    def _add_streams(self, client: Endpoint, *, is_near: bool) -> Conversation:
        ends = self._endpoints
        conversation = Conversation(client, ends.controller, ends.transport, SERVER_PARTICIPANT)
        for up, streams in self.streams.items():
            flow = Flow(conversation, Direction.REQUEST if up else Direction.RESPONSE)
            splitter = StreamSplitter(budget=self._budget, templates=self._templates)
            stream = _DirectionStream(flow, splitter, is_near=is_near)
            streams.insert(len(streams) if up else 0, stream)
        return conversation


class RecordDecoder:
    def __init__(self, join_legs: Callable[[Conversation, Conversation], object] | None = None) -> None:
        """Create a decoder. Before it decodes the controller's side of a client's traffic, it calls
        `join_legs` with two conversations: client to proxy, and proxy to controller. If `join_legs` is None,
        the decoder never decodes the controller's side.
        """
        self.observation_count = 0
        self._join_legs = join_legs
        self._clients: dict[int, _Client] = {}
        self._budget = ByteBudget()
        self._templates = FrameTemplates()
        self._closed_clients: list[tuple[Conversation, Message]] = []

    @property
    def client_numbers(self) -> dict[Conversation, int]:
        return {client.conversation: number for number, client in self._clients.items()}

    @property
    def last_heard(self) -> dict[Conversation, int]:
        """Time of each client's last request, in ns since 1970."""
        return {client.conversation: client.last_heard for client in self._clients.values()}

    def next_number(self) -> int:
        self.observation_count += 1
        return self.observation_count

    def pop_closed_clients(self) -> list[tuple[Conversation, Message]]:
        """Return the clients that the relay removed since the last call, each with the reason."""
        gone, self._closed_clients = self._closed_clients, []
        return gone

    def decode(
        self, records: Iterable[RingRecord], packets: Iterable[int] | None = None
    ) -> Iterator[NotedObservation]:
        """Yield the observations that the records contain. `packets` holds the number of each record's packet
        in the recording, or 0 if a record has no packet. Without a recording, `packets` is None.
        """
        clients = self._clients
        for record, packet in zip(records, packets or repeat(0), strict=False):
            kind, up, number, received_at, sent_at, data, encoded = record
            note = decode_message(encoded) if encoded else None
            if kind is RingRecordKind.CLIENT_OPENED:
                endpoints = read_endpoints(record.data)
                clients[number] = _Client(endpoints, received_at, self._budget, self._templates)
                continue
            client = clients.get(number)
            if client is None:
                continue
            if kind is not RingRecordKind.DATA:
                yield from self._decode_event(client, record)
                continue
            if up and received_at:
                client.last_heard = received_at
            if not client.decodes_far_side and (note is not None or not (received_at and sent_at)):
                self._decode_far_side(client)
            for stream in client.streams[up]:
                time = received_at if up is stream.is_near else sent_at
                if not time:
                    continue
                stream.packet = packet if stream.is_near else 0
                if client.is_stream:
                    yield from self._decode_stream(stream, data, time, note)
                    continue
                for item in parse_captured_datagram(data, self._templates):
                    yield self._observation(stream, time, time, item, note), note

    def _decode_far_side(self, client: _Client) -> None:
        if self._join_legs is not None and client.is_between_frames:
            self._join_legs(client.conversation, client.decode_far_side())

    def _decode_event(self, client: _Client, record: RingRecord) -> Iterator[NotedObservation]:
        kind = record.kind
        if kind is RingRecordKind.HOLE:
            if record.up and record.received_at:
                client.last_heard = record.received_at
            for stream in client.streams[record.up]:
                yield from self._decode_hole(stream, record)
        elif kind in (RingRecordKind.END, RingRecordKind.RESET):
            yield from self._decode_end(client, record)
        elif kind is RingRecordKind.CLIENT_CLOSED:
            del self._clients[record.client]
            self._closed_clients.append((client.conversation, decode_message(record.data)))
            streams = [stream for side in client.streams.values() for stream in side]
            for stream in sorted(streams, key=lambda stream: stream.is_near):
                yield from self._flush(stream, record.received_at)

    def _decode_stream(
        self, stream: _DirectionStream, data: bytes, time: int, note: Message | None
    ) -> Iterator[NotedObservation]:
        if not stream.splitter.pending_bytes:
            # `arrival_times[0]` must hold the arrival time of the first byte of a frame
            stream.arrival_times.clear()
        stream.arrival_times.append((stream.size, time))
        stream.size += len(data)
        yield from self._make_observations(stream, stream.splitter.feed(data), time, note)
        if len(stream.arrival_times) > _MAX_MARKS:
            del stream.arrival_times[1 : _MAX_MARKS // 2]

    def _decode_hole(self, stream: _DirectionStream, record: RingRecord) -> Iterator[NotedObservation]:
        received, sent = hole_sizes(record)
        is_received = record.up is stream.is_near
        size, when = (received, record.received_at) if is_received else (sent, record.sent_at)
        if size:
            stream.arrival_times.append((stream.size, when))
            stream.size += size
            yield from self._make_observations(stream, stream.splitter.add_gap(size), when, None)

    def _decode_end(self, client: _Client, record: RingRecord) -> Iterator[NotedObservation]:
        _, up, _, received_at, sent_at, *_ = record
        if received_at:  # `received_at` is 0 if the proxy itself ended the connection
            is_reset = record.kind is RingRecordKind.RESET
            direction = Direction.REQUEST if up else Direction.RESPONSE
            client.conversation.record_end(direction, is_reset, received_at)
        for stream in client.streams[up]:
            if time := received_at if up is stream.is_near else sent_at:
                yield from self._flush(stream, time)

    def _flush(self, stream: _DirectionStream, time: int) -> Iterator[NotedObservation]:
        return self._make_observations(stream, stream.splitter.close(), time, None)

    def _make_observations(
        self, stream: _DirectionStream, pieces: Iterable[StreamPiece], time: int, note: Message | None
    ) -> Iterator[NotedObservation]:
        for start, stop, item in pieces:
            place = bisect_right(stream.arrival_times, start, key=_offset) - 1
            start_time = stream.arrival_times[place][1]
            yield self._observation(stream, time, start_time, item, note), note
            del stream.arrival_times[: bisect_right(stream.arrival_times, stop, key=_offset) - 1]

    def _observation(
        self,
        stream: _DirectionStream,
        time: int,
        first_byte_time: int,
        item: Frame | Malformed,
        note: Message | None,
    ) -> Observation:
        number = self.next_number() if stream.is_near else 0
        if not stream.is_joined:
            return Observation(number, time, first_byte_time, stream.flow, item, stream.packet)
        seen = RelayedObservation(number, time, first_byte_time, stream.flow, item, stream.packet)
        seen.note = note
        return seen
