"""Where TCP clients wait until they have sent a complete frame; it does no I/O and reads no clock.

A connection costs an attacker nothing, but a place among the clients is lost to everybody else. So a
connection gets a place only when its first frame is complete, and silent connections are dropped first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from ipaddress import ip_network
from typing import Generic, TypeVar

from bcapscope.protocol.first_frame import is_first_frame_incomplete

MAX_PENDING = 256
"""Connections without a complete frame; one more drops another. On a busy machine an honest client may need
some milliseconds between its connection and its first byte, in which a flood brings a hundred others."""

FIRST_FRAME_TIMEOUT = 10_000_000_000
"""ns between the first byte of a first frame and its last."""

Key = TypeVar("Key", bound=Hashable)


def source_network(host: str) -> str:
    """Return what limits are counted by: an IPv4 address, or the /64 network of an IPv6 address."""
    return host if ":" not in host else str(ip_network((host.partition("%")[0], 64), strict=False))


class _PendingConnection:
    """A connection that waits.

    Attributes:
        source: where it comes from.
        data: what it has sent.
        first_byte_at: when it sent the first byte, ns; 0 if it has sent nothing.
    """

    __slots__ = ("data", "first_byte_at", "source")

    def __init__(self, source: str) -> None:
        self.source = source
        self.data = bytearray()
        self.first_byte_at = 0


class FirstFrameQueue(Generic[Key]):
    """Connections that have not sent a complete frame yet."""

    def __init__(self, limit: int = MAX_PENDING) -> None:
        self._limit = limit
        self._waiting: dict[Key, _PendingConnection] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def __contains__(self, key: object) -> bool:
        return key in self._waiting

    def add(self, key: Key, host: str) -> Key | None:
        """Let a connection wait; return the connection to drop for it, None if there is room.

        That is the oldest of the source with the most connections. It does not help to have sent a few bytes:
        an honest client that has just connected has sent none.
        """
        dropped = self._next_to_drop() if len(self._waiting) >= self._limit else None
        if dropped is not None:
            del self._waiting[dropped]
        self._waiting[key] = _PendingConnection(source_network(host))
        return dropped

    def feed_bytes(self, key: Key, data: bytes, now: int) -> bytes | None:
        """Take bytes of a connection.

        Returns:
            All that it has sent, once its first frame is complete or its bytes begin none; it waits no more.
            None before.
        """
        newcomer = self._waiting[key]
        newcomer.first_byte_at = newcomer.first_byte_at or now
        newcomer.data += data
        if is_first_frame_incomplete(newcomer.data):
            return None
        del self._waiting[key]
        return bytes(newcomer.data)

    def remove(self, key: Key) -> None:
        """Forget a connection that has ended."""
        self._waiting.pop(key, None)

    def drop_one(self) -> Key | None:
        """Remove the connection with the lowest priority and return it; None if none waits."""
        dropped = self._next_to_drop()
        if dropped is not None:
            del self._waiting[dropped]
        return dropped

    def drop_overdue(self, now: int) -> list[Key]:
        """Forget the connections whose first frame takes too long, and return them."""
        late = [
            key
            for key, each in self._waiting.items()
            if each.first_byte_at and now - each.first_byte_at > FIRST_FRAME_TIMEOUT
        ]
        for key in late:
            del self._waiting[key]
        return late

    def _next_to_drop(self) -> Key | None:
        if not self._waiting:
            return None
        ((source, _),) = Counter(each.source for each in self._waiting.values()).most_common(1)
        return next(key for key, each in self._waiting.items() if each.source == source)
