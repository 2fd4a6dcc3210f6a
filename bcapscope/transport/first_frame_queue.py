"""TCP connections that have not sent a complete frame yet; no I/O and no clock.

A connection costs an attacker nothing, but each place it takes is lost to honest clients. So a connection
counts as a client only once its first frame is complete. Connections without a complete frame are dropped
first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from ipaddress import ip_network
from typing import Generic, TypeVar

from bcapscope.protocol.first_frame import is_first_frame_incomplete

MAX_PENDING = 256
"""Connections without a complete frame; at this limit, a new one displaces another. On a busy machine an
honest client may need some ms between connecting and its first byte. A flood opens a hundred connections in
that time."""

FIRST_FRAME_TIMEOUT = 10_000_000_000
"""Longest time between the first and the last byte of a first frame, ns."""

Key = TypeVar("Key", bound=Hashable)


def source_network(host: str) -> str:
    """Return the key that limits count by: an IPv4 address, or the /64 network of an IPv6 address."""
    return host if ":" not in host else str(ip_network((host.partition("%")[0], 64), strict=False))


class _PendingConnection:
    """A connection without a complete frame.

    Attributes:
        source: Network of the client, as `source_network` returns it.
        data: Bytes received so far.
        first_byte_at: Time of the first byte, ns; 0 before it.
    """

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
        """Add a connection; return the connection that the caller must drop for it, None if there is room.

        The dropped connection is the oldest of the source with the most connections. A few bytes do not
        protect a connection, because an honest client that has just connected has sent none.
        """
        dropped = self._next_to_drop() if len(self._waiting) >= self._limit else None
        if dropped is not None:
            del self._waiting[dropped]
        self._waiting[key] = _PendingConnection(source_network(host))
        return dropped

    def feed_bytes(self, key: Key, data: bytes, now: int) -> bytes | None:
        """Add bytes that a connection sent at the time `now`, ns.

        Once its first frame is complete, or its bytes cannot begin a frame, the connection leaves the queue,
        and all its bytes are returned; None before that.
        """
        newcomer = self._waiting[key]
        newcomer.first_byte_at = newcomer.first_byte_at or now
        newcomer.data += data
        if is_first_frame_incomplete(newcomer.data):
            return None
        del self._waiting[key]
        return bytes(newcomer.data)

    def remove(self, key: Key) -> None:
        """Remove a connection that has ended; unknown connections are ignored."""
        self._waiting.pop(key, None)

    def drop_one(self) -> Key | None:
        """Remove the connection that `add` would drop and return it; None if the queue is empty."""
        dropped = self._next_to_drop()
        if dropped is not None:
            del self._waiting[dropped]
        return dropped

    def drop_overdue(self, now: int) -> list[Key]:
        """Remove and return the connections whose first frame takes longer than `FIRST_FRAME_TIMEOUT`."""
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
