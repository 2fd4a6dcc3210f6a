"""Two ends in one process, with a network between them that is as bad as one likes."""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import Callable, Iterable
from typing import TypeAlias

from bcapscope.transport.peer_link import Address, LinkReceiver

NetworkModel: TypeAlias = Callable[[bytes], Iterable[float]]
"""What becomes of a packet: for each copy that arrives, after how many seconds; none for one that is lost."""


def perfect_network(_: bytes) -> Iterable[float]:
    """Let each packet arrive once, at once."""
    return (0.0,)


class MemoryLink:
    """One end of a pair. Packets are delivered by the event loop's timers, never inside `send`."""

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
        """Send a packet, or the next bytes of a stream, which arrive in order whatever the weather."""
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
        """Close this end; the other end of a stream is told."""
        other, self._far_end = self._far_end, None
        self.receiver = None
        if other is not None and not self.datagrams:
            other._on_far_end_closed()

    def _deliver_first(self, other: MemoryLink) -> None:
        """Hand over what is first: timers of one moment come in any order."""
        _, _, data = heapq.heappop(self._in_flight)
        if other.receiver is not None:
            other.receiver.on_data(data)

    def _on_far_end_closed(self) -> None:
        self._far_end = None
        receiver, self.receiver = self.receiver, None
        if receiver is not None:
            receiver.on_link_lost("the peer closed the connection")


def memory_link_pair(
    to_server: NetworkModel = perfect_network,
    to_client: NetworkModel = perfect_network,
    datagrams: bool = True,
) -> tuple[MemoryLink, MemoryLink]:
    """Make the client's and the server's end of a link; set the `receiver` of each.

    Args:
        to_server: becomes of what the client sends.
        to_client: becomes of what the server sends.
        datagrams: as UDP, or a stream as TCP.
    """
    client_address, server_address = ("memory", 1), ("memory", 5007)
    client = MemoryLink(client_address, server_address, to_server, datagrams)
    server = MemoryLink(server_address, client_address, to_client, datagrams)
    client._far_end, server._far_end = server, client
    return client, server
