"""From what the relay tells to observations: what each client said and was told.

Observed is the clients' side: requests as they came, replies as they were sent on. What the rules lost on
the way to the controller was still said; what they lost on the way back was not heard.
"""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from bcapscope.protocol.budget import Budget
from bcapscope.protocol.frame import parse_datagram
from bcapscope.protocol.stream import Piece, Splitter
from bcapscope.proxy.ring import Kind, Record, unseen
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)

_MOST_MARKS = 256
"""Pieces of one unfinished frame whose times are kept apart."""


class Met(NamedTuple):
    """A client of the relay.

    Attributes:
        transport: UDP or TCP.
        client: where it is.
        listen: where it came to.
        upstream: our end towards the controller.
        controller: where that is.
    """

    transport: Transport
    client: Endpoint
    listen: Endpoint
    upstream: Endpoint
    controller: Endpoint


def met(record: Record) -> Met:
    """Read a record of the kind `OPENED`."""
    transport, *ends = json.loads(record.data)
    client, listen, upstream, controller = (Endpoint(host, port) for host, port in ends)
    return Met(Transport(transport), client, listen, upstream, controller)


class _Way:
    """One direction of a client's conversation."""

    def __init__(self, conversation: Conversation, direction: Direction, budget: Budget) -> None:
        self.flow = Flow(conversation, direction)
        self.splitter = Splitter(budget=budget)
        self.size = 0
        self.marks: list[tuple[int, int]] = [(0, 0)]  # offset in the stream, and when what is there came


class _Client:
    def __init__(self, who: Met, came: int, budget: Budget) -> None:
        self.heard = came
        conversation = Conversation(who.client, who.controller, who.transport, "the proxy")
        self.conversation = conversation
        self.is_stream = who.transport is Transport.TCP
        response, request = Direction.RESPONSE, Direction.REQUEST
        self.ways = _Way(conversation, response, budget), _Way(conversation, request, budget)

    def ended(self, up: bool, reset: bool, time: int) -> None:
        """Note that an end closed the connection."""
        self.conversation.close(self.ways[up].flow.direction, reset, time)


class Witness:
    """Follows all clients.

    Attributes:
        count: observations so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._clients: dict[int, _Client] = {}
        self._budget = Budget()
        self._gone: list[tuple[Conversation, str]] = []

    @property
    def numbers(self) -> dict[Conversation, int]:
        """The relay's number of each client that is there."""
        return {client.conversation: number for number, client in self._clients.items()}

    @property
    def heard(self) -> dict[Conversation, int]:
        """When each client that is there was heard last, ns since 1970."""
        return {client.conversation: client.heard for client in self._clients.values()}

    def gone(self) -> list[tuple[Conversation, str]]:
        """Return who has gone since this was asked last, and why: words from the relay."""
        gone, self._gone = self._gone, []
        return gone

    def observe(self, records: Iterable[Record]) -> Iterator[tuple[Observation, str]]:
        """Yield what was said, with what a rule did to it."""
        clients = self._clients
        for record in records:
            kind, up, number, came, left, data, note = record
            if kind is Kind.OPENED:
                clients[number] = _Client(met(record), came, self._budget)
                continue
            client = clients.get(number)
            if client is None:
                continue
            if kind is Kind.DATA:
                time = came if up else left
                if not time:
                    continue
                if up:
                    client.heard = time
                way = client.ways[up]
                if client.is_stream:
                    yield from self._stream(way, data, time, note)
                    continue
                for item in parse_datagram(data):
                    self.count += 1
                    yield Observation(self.count, time, time, way.flow, item, 0), note
            else:
                yield from self._event(client, record)

    def _event(self, client: _Client, record: Record) -> Iterator[tuple[Observation, str]]:
        """Yield what anything but data brings to light."""
        kind = record.kind
        if kind is Kind.HOLE:
            if record.up and record.came:
                client.heard = record.came
            yield from self._hole(client.ways[record.up], record)
        elif kind in (Kind.END, Kind.RESET):
            yield from self._ended(client, record)
        elif kind is Kind.GONE:
            del self._clients[record.client]
            self._gone.append((client.conversation, record.data.decode("utf-8", "replace")))
            for way in client.ways:
                yield from self._end(way, record.came)

    def _stream(self, way: _Way, data: bytes, time: int, note: str) -> Iterator[tuple[Observation, str]]:
        way.marks.append((way.size, time))
        way.size += len(data)
        yield from self._pieces(way, way.splitter.feed(data), time, note)
        if len(way.marks) > _MOST_MARKS:
            del way.marks[1 : _MOST_MARKS // 2]

    def _hole(self, way: _Way, record: Record) -> Iterator[tuple[Observation, str]]:
        came, left = unseen(record)
        size, when = (came, record.came) if record.up else (left, record.left)
        if size:
            way.marks.append((way.size, when))
            way.size += size
            yield from self._pieces(way, way.splitter.gap(size), when, "")

    def _ended(self, client: _Client, record: Record) -> Iterator[tuple[Observation, str]]:
        _, up, _, came, left, *_ = record
        if came:  # else it is the proxy that ends it
            client.ended(up, record.kind is Kind.RESET, came)
        if time := came if up else left:
            yield from self._end(client.ways[up], time)

    def _end(self, way: _Way, time: int) -> Iterator[tuple[Observation, str]]:
        yield from self._pieces(way, way.splitter.close(), time, "")

    def _pieces(
        self, way: _Way, pieces: Iterable[Piece], time: int, note: str
    ) -> Iterator[tuple[Observation, str]]:
        for start, stop, item in pieces:
            place = bisect_right(way.marks, start, key=_offset) - 1
            self.count += 1
            yield Observation(self.count, time, way.marks[place][1] or time, way.flow, item, 0), note
            del way.marks[: max(bisect_right(way.marks, stop, key=_offset) - 1, 0)]


def _offset(mark: tuple[int, int]) -> int:
    return mark[0]
