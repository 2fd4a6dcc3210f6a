"""Datagrams that have come and were not looked at yet: each sender has its turn, whatever others send."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator
from typing import Generic, TypeVar

MOST_OF_ONE = 32
"""Datagrams of one sender: more than the tries of any call, and some calls."""

MOST_BYTES = 2 << 20
"""Of all senders, with `_COST` for each datagram."""

_COST = 512

Sender = TypeVar("Sender", bound=Hashable)


class Turns(Generic[Sender]):
    """What waits, by sender.

    Attributes:
        unheard: datagrams that came too fast, and were thrown away.
    """

    def __init__(self) -> None:
        self.unheard = 0
        self._waiting: dict[Sender, deque[tuple[int, bytes]]] = {}
        self._bytes = 0

    def __bool__(self) -> bool:
        """Tell whether anything waits."""
        return bool(self._waiting)

    @property
    def since(self) -> int:
        """When the oldest of those came that wait."""
        return min(queue[0][0] for queue in self._waiting.values())

    def add(self, sender: Sender, came: int, data: bytes) -> None:
        """Let a datagram wait that came at a given time; one too many is thrown away."""
        queue = self._waiting.get(sender)
        size = len(data) + _COST
        if self._bytes + size > MOST_BYTES or (queue is not None and len(queue) >= MOST_OF_ONE):
            self.unheard += 1
            return
        if queue is None:
            queue = self._waiting[sender] = deque()
        queue.append((came, data))
        self._bytes += size

    def take(self) -> Iterator[tuple[Sender, int, bytes]]:
        """Yield the oldest datagram of each sender, and when it came."""
        for sender in list(self._waiting):
            queue = self._waiting[sender]
            came, data = queue.popleft()
            self._bytes -= len(data) + _COST
            if not queue:
                del self._waiting[sender]
            yield sender, came, data
