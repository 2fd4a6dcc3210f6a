"""Queue of datagrams that wait for processing; senders take turns, however much each one sends."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator
from typing import TypeAlias

MAX_PER_SENDER = 32
"""Maximum number of waiting datagrams of one sender: the attempts of a call, and some further calls."""

MAX_BYTES = 2 << 20
"""Maximum number of waiting bytes of all senders; each datagram adds `_COST` to its size."""

_COST = 512

Sender: TypeAlias = Hashable
"""Address of a client."""


class DatagramQueue:
    """Waiting datagrams by sender, oldest first; `dropped` counts the datagrams that did not fit."""

    def __init__(self) -> None:
        self.waiting: dict[Sender, deque[tuple[int, bytes]]] = {}
        self.dropped = 0
        self._bytes = 0

    @property
    def oldest_arrival(self) -> int:
        return min(queue[0][0] for queue in self.waiting.values())

    def add(self, sender: Sender, received_at: int, data: bytes) -> None:
        """Queue a datagram with its arrival time; drop the datagram if too many are waiting."""
        queue = self.waiting.get(sender)
        size = len(data) + _COST
        if self._bytes + size > MAX_BYTES or (queue is not None and len(queue) >= MAX_PER_SENDER):
            self.dropped += 1
            return
        if queue is None:
            queue = self.waiting[sender] = deque()
        queue.append((received_at, data))
        self._bytes += size

    def pop_one_per_sender(self) -> Iterator[tuple[Sender, int, bytes]]:
        """Remove the oldest datagram of each sender and yield its sender, arrival time and bytes."""
        for sender in list(self.waiting):
            queue = self.waiting[sender]
            came, data = queue.popleft()
            self._bytes -= len(data) + _COST
            if not queue:
                del self.waiting[sender]
            yield sender, came, data
