"""Two link ends in one process, joined by a simulated network that can delay, lose or repeat packets."""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import Callable, Iterable
from typing import TypeAlias

from bcapscope.client.session import LinkOpener
from bcapscope.messages import Message
from bcapscope.transport.peer_link import Address, Link, LinkReceiver

NetworkModel: TypeAlias = Callable[[bytes], Iterable[float]]
"""Function that returns the delay in s of each copy of a packet that arrives; empty for a lost packet."""


def perfect_network(_: bytes) -> Iterable[float]:
    return (0.0,)


class MemoryLink:
    """One end of a memory link. Timers of the event loop deliver the packets; `send` itself never does."""

    def __init__(self, local: Address, peer: Address, network: NetworkModel, datagrams: bool) -> None:
        self.local = local
        self.peer = peer
        self.datagrams = datagrams
        self.receiver: LinkReceiver | None = None
        self._network = network
        self._far_end: MemoryLink | None = None
        self._last_delivery = 0.0
        self._in_flight: list[tuple[float, int, bytes]] = []
        self._sent_count = 0

    def send(self, data: bytes) -> None:
        """Send a packet, or the next bytes of a stream.

        The bytes of a stream arrive in order, whatever the delays.
        """
        other = self._far_end
        if other is None:
            return
        loop = asyncio.get_running_loop()
        for delay in self._network(data):
            when = loop.time() + delay
            if not self.datagrams:
                self._last_delivery = when = max(when, self._last_delivery)
            self._sent_count += 1
            heapq.heappush(self._in_flight, (when, self._sent_count, data))
            loop.call_at(when, self._deliver_first, other)

    def close(self) -> None:
        """Close this end. On a stream, the receiver of the other end gets `on_link_lost`."""
        other, self._far_end = self._far_end, None
        self.receiver = None
        if other is not None and not self.datagrams:
            other._on_far_end_closed()

    def _deliver_first(self, other: MemoryLink) -> None:
        """Deliver the earliest packet. The event loop may run timers of the same time in any order."""
        _, _, data = heapq.heappop(self._in_flight)
        if other.receiver is not None:
            other.receiver.on_data(data)

    def _on_far_end_closed(self) -> None:
        self._far_end = None
        receiver, self.receiver = self.receiver, None
        if receiver is not None:
            receiver.on_link_lost(Message("connection.closed-by-peer"))


def memory_link_pair(
    to_server: NetworkModel = perfect_network,
    to_client: NetworkModel = perfect_network,
    datagrams: bool = True,
) -> tuple[MemoryLink, MemoryLink]:
    """Return the client's and the controller's end of a link; the caller sets the `receiver` of each end.

    Each direction has its own network model. Without `datagrams`, the link is a stream as over TCP.
    """
    client_address, server_address = ("memory", 1), ("memory", 5007)
    client = MemoryLink(client_address, server_address, to_server, datagrams)
    server = MemoryLink(server_address, client_address, to_client, datagrams)
    client._far_end, server._far_end = server, client
    return client, server


def over_link(link: MemoryLink) -> LinkOpener:
    """Return a link opener for a controller in this process, to which `link` leads."""

    async def open_it(receiver: LinkReceiver) -> Link:
        link.receiver = receiver
        return link

    return open_it
