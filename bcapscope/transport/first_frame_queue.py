"""TCP connections that have not sent a complete frame yet. This module does no I/O and uses no clock.

An attacker can open many connections at no cost. Therefore a connection becomes a client only when its first
frame is complete, and connections without a complete frame are dropped first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from dataclasses import dataclass, field
from ipaddress import ip_network
from typing import Generic, TypeVar

from bcapscope.protocol.first_frame import is_first_frame_incomplete

MAX_PENDING = 256
"""Maximum number of connections without a complete frame. On a busy machine, an honest client may send its
first byte some milliseconds after it connects; meanwhile, an attacker can open a hundred connections.
"""

FIRST_FRAME_TIMEOUT = 10_000_000_000
"""Maximum time in ns between the first and the last byte of a connection's first frame."""

Key = TypeVar("Key", bound=Hashable)


def source_network(host: str) -> str:
    """Return an IPv4 address, or the /64 network of an IPv6 address, whose clients are counted together."""
    return host if ":" not in host else str(ip_network((host.partition("%")[0], 64), strict=False))


@dataclass(eq=False)
class _PendingConnection:
    """`first_byte_at` is the time in ns when the first byte arrived; 0 before."""

    source: str
    data: bytearray = field(default_factory=bytearray)
    first_byte_at: int = 0


class FirstFrameQueue(Generic[Key]):
    def __init__(self, limit: int = MAX_PENDING) -> None:
        self._limit = limit
        self._waiting: dict[Key, _PendingConnection] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def __contains__(self, key: object) -> bool:
        return key in self._waiting

    def add(self, key: Key, host: str) -> Key | None:
        """Add a connection. If there is no room, return the connection that the caller must drop.

        The caller drops the oldest connection of the source network with the most connections. The choice
        does not depend on the number of received bytes, because a normal client may not have sent any yet.
        """
        dropped = self.drop_one() if len(self._waiting) >= self._limit else None
        self._waiting[key] = _PendingConnection(source_network(host))
        return dropped

    def feed_bytes(self, key: Key, data: bytes, now: int) -> bytes | None:
        """Add bytes that arrived at the time `now`, ns. When the first frame is complete, or the bytes cannot
        begin a frame, remove the connection and return all its bytes. Until then, return None.
        """
        newcomer = self._waiting[key]
        newcomer.first_byte_at = newcomer.first_byte_at or now
        newcomer.data += data
        if is_first_frame_incomplete(newcomer.data):
            return None
        del self._waiting[key]
        return bytes(newcomer.data)

    def remove(self, key: Key) -> None:
        self._waiting.pop(key, None)

    def drop_one(self) -> Key | None:
        if not self._waiting:
            return None
        ((source, _),) = Counter(each.source for each in self._waiting.values()).most_common(1)
        dropped = next(key for key, each in self._waiting.items() if each.source == source)
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
