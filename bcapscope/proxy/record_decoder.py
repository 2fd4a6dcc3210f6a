"""Decodes the records in the relay's ring into observations: the requests and replies of each client.

Observations show the client's side: requests as received by the proxy, and replies as sent to the client. A
request that a proxy rule dropped therefore gives an observation; a reply that a proxy rule dropped does not.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import repeat
from typing import TypeAlias

from bcapscope.messages import Message
from bcapscope.messages.message_codec import decode_message
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import parse_captured_datagram
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import StreamPiece, StreamSplitter
from bcapscope.proxy.relay_session import ClientEndpoints, read_endpoints
from bcapscope.proxy.ring_buffer import RingRecord, RingRecordKind, hole_sizes
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Flow,
    Observation,
    Transport,
)

NotedObservation: TypeAlias = tuple[Observation, Message | None]
"""An observation, and a note that says what a proxy rule did to the message. The note is None if no rule
changed the message.
"""

_MAX_MARKS = 256
"""The decoder keeps the arrival times of at most this many pieces of an unfinished frame."""


class _DirectionStream:
    """One direction of a client's conversation.

    Attributes:
        size: Number of bytes of the stream so far.
        arrival_times: Offsets in the stream, each with the time in ns of the bytes that start there.
        packet: Number of the last packet of the stream in the recording; 0 if the recording has none.
    """

    def __init__(self, flow: Flow, splitter: StreamSplitter) -> None:
        self.flow = flow
        self.splitter = splitter
        self.size = self.packet = 0
        self.arrival_times: list[tuple[int, int]] = []


class _Client:
    def __init__(
        self, endpoints: ClientEndpoints, received_at: int, budget: ByteBudget, templates: FrameTemplates
    ) -> None:
        self.last_heard = received_at
        conversation = Conversation(
            endpoints.client, endpoints.controller, endpoints.transport, SERVER_PARTICIPANT
        )
        self.conversation = conversation
        self.is_stream = endpoints.transport is Transport.TCP
        self.streams = tuple(
            _DirectionStream(
                Flow(conversation, direction), StreamSplitter(budget=budget, templates=templates)
            )
            for direction in (Direction.RESPONSE, Direction.REQUEST)
        )


class RecordDecoder:
    """Decodes the records of all clients."""

    def __init__(self) -> None:
        self.observation_count = 0
        self._clients: dict[int, _Client] = {}
        self._budget = ByteBudget()
        self._templates = FrameTemplates()
        self._closed_clients: list[tuple[Conversation, Message]] = []

    @property
    def client_numbers(self) -> dict[Conversation, int]:
        """The relay's number for each connected client, by conversation."""
        return {client.conversation: number for number, client in self._clients.items()}

    @property
    def last_heard(self) -> dict[Conversation, int]:
        """Time of the last request of each connected client, in ns since 1970."""
        return {client.conversation: client.last_heard for client in self._clients.values()}

    def pop_closed_clients(self) -> list[tuple[Conversation, Message]]:
        """Return the clients that the relay removed since the last call of this method. Each client comes
        with the reason.
        """
        gone, self._closed_clients = self._closed_clients, []
        return gone

    def decode(
        self, records: Iterable[RingRecord], packets: Iterable[int] | None = None
    ) -> Iterator[NotedObservation]:
        """Yield each observation, with a note that says what a proxy rule did to the message. The note is
        None if no rule changed the message.

        Args:
            packets: For each record, the number of its packet in the recording, or 0 if it has no packet.
                `packets` is None if there is no recording.
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
            if kind is RingRecordKind.DATA:
                time = received_at if up else sent_at
                if not time:
                    continue
                if up:
                    client.last_heard = time
                stream = client.streams[up]
                if client.is_stream:
                    stream.packet = packet
                    yield from self._decode_stream(stream, data, time, note)
                    continue
                for item in parse_captured_datagram(data, self._templates):
                    self.observation_count += 1
                    yield Observation(self.observation_count, time, time, stream.flow, item, packet), note
            else:
                yield from self._decode_event(client, record)

    def _decode_event(self, client: _Client, record: RingRecord) -> Iterator[NotedObservation]:
        """Yield the observations that a record gives if its kind is not `DATA`."""
        kind = record.kind
        if kind is RingRecordKind.HOLE:
            if record.up and record.received_at:
                client.last_heard = record.received_at
            yield from self._decode_hole(client.streams[record.up], record)
        elif kind in (RingRecordKind.END, RingRecordKind.RESET):
            yield from self._decode_end(client, record)
        elif kind is RingRecordKind.CLIENT_CLOSED:
            del self._clients[record.client]
            self._closed_clients.append((client.conversation, decode_message(record.data)))
            for stream in client.streams:
                yield from self._flush_direction(stream, record.received_at)

    def _decode_stream(
        self, stream: _DirectionStream, data: bytes, time: int, note: Message | None
    ) -> Iterator[NotedObservation]:
        if not stream.splitter.pending_bytes:
            # the first entry must be the arrival time of a frame's first byte
            stream.arrival_times.clear()
        stream.arrival_times.append((stream.size, time))
        stream.size += len(data)
        yield from self._make_observations(stream, stream.splitter.feed(data), time, note)
        if len(stream.arrival_times) > _MAX_MARKS:
            del stream.arrival_times[1 : _MAX_MARKS // 2]

    def _decode_hole(self, stream: _DirectionStream, record: RingRecord) -> Iterator[NotedObservation]:
        received, sent = hole_sizes(record)
        size, when = (received, record.received_at) if record.up else (sent, record.sent_at)
        if size:
            stream.arrival_times.append((stream.size, when))
            stream.size += size
            yield from self._make_observations(stream, stream.splitter.add_gap(size), when, None)

    def _decode_end(self, client: _Client, record: RingRecord) -> Iterator[NotedObservation]:
        _, up, _, received_at, sent_at, *_ = record
        if received_at:  # `received_at` is 0 if the proxy itself ended the connection
            is_reset = record.kind is RingRecordKind.RESET
            client.conversation.record_end(client.streams[up].flow.direction, is_reset, received_at)
        if time := received_at if up else sent_at:
            yield from self._flush_direction(client.streams[up], time)

    def _flush_direction(self, stream: _DirectionStream, time: int) -> Iterator[NotedObservation]:
        yield from self._make_observations(stream, stream.splitter.close(), time, None)

    def _make_observations(
        self, stream: _DirectionStream, pieces: Iterable[StreamPiece], time: int, note: Message | None
    ) -> Iterator[NotedObservation]:
        for start, stop, item in pieces:
            place = bisect_right(stream.arrival_times, start, key=_offset) - 1
            self.observation_count += 1
            start_time = stream.arrival_times[place][1]
            number, packet = self.observation_count, stream.packet
            yield Observation(number, time, start_time, stream.flow, item, packet), note
            del stream.arrival_times[: max(bisect_right(stream.arrival_times, stop, key=_offset) - 1, 0)]


def _offset(mark: tuple[int, int]) -> int:
    return mark[0]
