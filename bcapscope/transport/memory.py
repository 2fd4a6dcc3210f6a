"""Two ends in one process, with a network between them that is as bad as one likes."""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import Callable, Iterable
from typing import TypeAlias

from bcapscope.transport.link import Address, Receiver

Weather: TypeAlias = Callable[[bytes], Iterable[float]]
"""What becomes of a packet: for each copy that arrives, after how many seconds; none for one that is lost."""


def calm(_: bytes) -> Iterable[float]:
    """Let each packet arrive once, at once."""
    return (0.0,)


class MemoryLink:
    """One end of a pair. Packets are delivered by the event loop's timers, never inside `send`."""

    def __init__(self, local: Address, peer: Address, weather: Weather, datagrams: bool) -> None:
        self.local = local
        self.peer = peer
        self.datagrams = datagrams
        self.receiver: Receiver | None = None
        self._weather = weather
        self._other: MemoryLink | None = None
        self._stream_until = 0.0
        self._on_the_way: list[tuple[float, int, bytes]] = []
        self._sent = 0

    def send(self, data: bytes) -> None:
        """Send a packet, or the next bytes of a stream, which arrive in order whatever the weather."""
        other = self._other
        if other is None:
            return
        loop = asyncio.get_running_loop()
        for delay in self._weather(data):
            when = loop.time() + delay
            if not self.datagrams:
                self._stream_until = when = max(when, self._stream_until)
            self._sent += 1
            heapq.heappush(self._on_the_way, (when, self._sent, data))
            loop.call_at(when, self._deliver, other)

    def close(self) -> None:
        """Close this end; the other end of a stream is told."""
        other, self._other = self._other, None
        self.receiver = None
        if other is not None and not self.datagrams:
            other._close_by_peer()

    def _deliver(self, other: MemoryLink) -> None:
        """Hand over what is first: timers of one moment come in any order."""
        _, _, data = heapq.heappop(self._on_the_way)
        if other.receiver is not None:
            other.receiver.received(data)

    def _close_by_peer(self) -> None:
        self._other = None
        receiver, self.receiver = self.receiver, None
        if receiver is not None:
            receiver.lost("the peer closed the connection")


def memory_pair(
    up: Weather = calm, down: Weather = calm, datagrams: bool = True
) -> tuple[MemoryLink, MemoryLink]:
    """Make the client's and the server's end of a link; set the `receiver` of each.

    Args:
        up: becomes of what the client sends.
        down: becomes of what the server sends.
        datagrams: as UDP, or a stream as TCP.
    """
    client_address, server_address = ("memory", 1), ("memory", 5007)
    client = MemoryLink(client_address, server_address, up, datagrams)
    server = MemoryLink(server_address, client_address, down, datagrams)
    client._other, server._other = server, client
    return client, server
