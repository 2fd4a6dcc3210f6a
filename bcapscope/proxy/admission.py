"""Decides which clients the proxy admits if too many clients connect. A new client that begins with a stop
always gets a slot.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum, auto
from operator import itemgetter
from typing import TYPE_CHECKING

from bcapscope.messages import Message
from bcapscope.transport.first_frame_queue import source_network

if TYPE_CHECKING:
    from bcapscope.proxy.relay_session import RelaySession

MAX_CLIENTS = 256
"""Maximum number of clients per transport. DENSO's C server accepts 20 clients per transport (orin_bcap
C/src/bCAPServer/bcap_server.c).
"""

MAX_PER_SOURCE = 192
"""Maximum number of clients per address. A whole plant may share one address behind NAT. The 64 slots that
remain for other addresses are enough for the clients of three controllers.
"""

RESERVED_SLOTS = 4
"""Number of additional slots per transport, reserved for clients that begin with a stop. If all reserved
slots are occupied, the next such client replaces the client that has held a reserved slot longest.
"""

REPLACE_INTERVAL_NS = 5_000_000
"""A fresh client is a client that has sent only one datagram. After a burst of `REPLACE_BURST` evictions, the
proxy may evict one fresh client per this time in ns. This limit keeps the cost low if many datagrams arrive
from new UDP ports.
"""

REPLACE_BURST = 64
"""Maximum number of fresh clients that the proxy may evict without waiting for `REPLACE_INTERVAL_NS`."""

TOO_MANY_CLIENTS = Message("client.silent.too-many")


class ClientSlot(Enum):
    NONE = auto()
    REGULAR = auto()
    RESERVED = auto()
    """A slot reserved for stops."""


class ClientSlots:
    """The slots of one transport."""

    def __init__(self) -> None:
        self._regular: dict[int, RelaySession] = {}
        self._reserved: dict[int, RelaySession] = {}
        self._fresh: dict[int, RelaySession] = {}
        self._sources: Counter[str] = Counter()
        self._replacements_left, self._replaced_at = REPLACE_BURST, 0
        self._exhausted_sources: set[str | None] = set()
        self._exhausted_at: int | None = None

    def __len__(self) -> int:
        return len(self._regular) + len(self._reserved)

    def find_slot(self, host: str, now: int, is_stop: bool) -> ClientSlot:
        """Find a slot for a new client at the address `host`. Evict another client if no slot is free."""
        source = source_network(host)
        if self._sources[source] >= MAX_PER_SOURCE:
            found = self._evict_one(source, now)
        else:
            found = len(self._regular) < MAX_CLIENTS or self._evict_one(None, now)
        if found:
            return ClientSlot.REGULAR
        if not is_stop:
            return ClientSlot.NONE
        if len(self._reserved) >= RESERVED_SLOTS:
            self.end_oldest_stop()
        return ClientSlot.RESERVED

    def occupy(self, session: RelaySession, slot: ClientSlot, is_fresh: bool) -> None:
        """Give a client the slot that `find_slot` found."""
        number = session.number
        if slot is ClientSlot.RESERVED:
            self._reserved[number] = session
            return
        self._regular[number] = session
        self._sources[session.source] += 1
        if is_fresh:
            self._fresh[number] = session

    def mark_established(self, number: int) -> None:
        """Protect a fresh client from early eviction, because it has sent a second datagram."""
        self._fresh.pop(number, None)

    def release(self, number: int) -> None:
        self._fresh.pop(number, None)
        self._reserved.pop(number, None)
        session = self._regular.pop(number, None)
        if session is not None:
            source = session.source
            self._sources[source] -= 1
            if not self._sources[source]:
                del self._sources[source]

    def end_oldest_stop(self) -> bool:
        """Disconnect the client that has held a reserved slot longest. Return False if no client holds a
        reserved slot.
        """
        return _evict(next(iter(self._reserved.values()), None))

    def _evict_one(self, source: str | None, now: int) -> bool:
        """Evict one client of the network `source`, or of any network if `source` is None. Return False if
        the proxy must not evict any of these clients.
        """
        return _evict(self._oldest_replaceable(source, now) or self._longest_idle(source, now))

    def _longest_idle(self, source: str | None, now: int) -> RelaySession | None:
        """Return the client that has been idle longest; None if the proxy must not evict any client. If a
        previous search with the same arguments found no client, return None without another search.
        """
        if now != self._exhausted_at:
            self._exhausted_at = now
            self._exhausted_sources.clear()
        if source in self._exhausted_sources:
            return None
        candidates = (each for each in self._regular.values() if source in (None, each.source))
        quiet = ((each.evictable_idle_ns(now), each) for each in candidates)
        found = [(length, each) for length, each in quiet if length is not None]
        if found:
            return max(found, key=itemgetter(0))[1]
        self._exhausted_sources.add(source)
        return None

    def _oldest_replaceable(self, source: str | None, now: int) -> RelaySession | None:
        """Return the first fresh client of the network `source`, or of any network if `source` is None. A
        fresh client has sent only one datagram. Return None if no client is fresh, or if the proxy has just
        evicted too many fresh clients (see `REPLACE_BURST`).
        """
        earned = (now - self._replaced_at) // REPLACE_INTERVAL_NS
        if earned:
            self._replacements_left = min(self._replacements_left + earned, REPLACE_BURST)
            self._replaced_at = now
        if not self._replacements_left:
            return None
        fresh = (each for each in self._fresh.values() if source in (None, each.source))
        victim = next(fresh, None)
        self._replacements_left -= victim is not None
        return victim


def _evict(victim: RelaySession | None) -> bool:
    if victim is None:
        return False
    victim.close(False, TOO_MANY_CLIENTS)
    return True
