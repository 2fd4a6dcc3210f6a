"""Datagrams that have come and were not looked at yet: each sender has its turn, whatever others send."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator
from typing import Generic, TypeVar

MAX_PER_SENDER = 32
"""Datagrams of one sender: more than the tries of any call, and some calls."""

MAX_BYTES = 2 << 20
"""Of all senders, with `_COST` for each datagram."""

_COST = 512

Sender = TypeVar("Sender", bound=Hashable)


class DatagramQueue(Generic[Sender]):
    """What waits, by sender.

    Attributes:
        waiting: when each of them came, and what it says; the oldest first.
        dropped: datagrams that came too fast, and were thrown away.
    """

    def __init__(self) -> None:
        self.waiting: dict[Sender, deque[tuple[int, bytes]]] = {}
        self.dropped = 0
        self._bytes = 0

    @property
    def oldest_arrival(self) -> int:
        """When the oldest of those came that wait."""
        return min(queue[0][0] for queue in self.waiting.values())

    def add(self, sender: Sender, received_at: int, data: bytes) -> None:
        """Let a datagram wait that came at a given time; one too many is thrown away."""
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
        """Yield the oldest datagram of each sender, and when it came."""
        for sender in list(self.waiting):
            queue = self.waiting[sender]
            came, data = queue.popleft()
            self._bytes -= len(data) + _COST
            if not queue:
                del self.waiting[sender]
            yield sender, came, data
