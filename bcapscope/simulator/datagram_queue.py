"""Datagrams that have arrived and wait; senders take turns, however much the others send."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator
from typing import Generic, TypeVar

MAX_PER_SENDER = 32
"""Datagrams of one sender: room for the attempts of any call, and some calls more."""

MAX_BYTES = 2 << 20
"""Bytes of all senders, with `_COST` added for each datagram."""

_COST = 512

Sender = TypeVar("Sender", bound=Hashable)


class DatagramQueue(Generic[Sender]):
    """Waiting datagrams by sender.

    Attributes:
        waiting: Arrival time and bytes of each datagram, oldest first.
        dropped: Datagrams dropped because they came too fast.
    """

    def __init__(self) -> None:
        self.waiting: dict[Sender, deque[tuple[int, bytes]]] = {}
        self.dropped = 0
        self._bytes = 0

    @property
    def oldest_arrival(self) -> int:
        return min(queue[0][0] for queue in self.waiting.values())

    def add(self, sender: Sender, received_at: int, data: bytes) -> None:
        """Queue a datagram with its arrival time; drop it if there are too many."""
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
        """Yield the oldest datagram of each sender: sender, arrival time, bytes."""
        for sender in list(self.waiting):
            queue = self.waiting[sender]
            came, data = queue.popleft()
            self._bytes -= len(data) + _COST
            if not queue:
                del self.waiting[sender]
            yield sender, came, data
