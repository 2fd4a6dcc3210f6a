"""Decides which clients the proxy admits when there are too many. It does no I/O and reads no clock.

Each transport has its own slots, and no address may take all of them. A new client whose first frame is a
stop always gets a slot: some are reserved for that.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum
from operator import itemgetter
from typing import Protocol

from bcapscope.messages import Message
from bcapscope.transport.first_frame_queue import source_network

MAX_CLIENTS = 256
"""Clients of each transport, on all listeners; DENSO's C server has 20 (orin_bcap C/src/bcap_server.c)."""

MAX_PER_SOURCE = 192
"""Clients of one address, which may stand for a whole plant. The rest is enough for three controllers."""

RESERVED_SLOTS = 4
"""More slots of each transport, for clients whose first frame is a stop. The newest of them stay."""

REPLACE_INTERVAL_NS = 5_000_000
"""ns between two evictions when all slots are taken: limits the cost of a flood from ever new UDP ports."""

REPLACE_BURST = 64
"""Evictions without that delay, after a quiet time."""

TOO_MANY_CLIENTS = Message("client.silent.too-many")
"""Reason for ending a client that is evicted for another."""


class Occupant(Protocol):
    """A client that has a slot."""

    @property
    def number(self) -> int:
        """Number of the client, never used twice."""

    @property
    def source(self) -> str:
        """Network of the client; see `source_network`."""

    def evictable_idle_ns(self, now: int) -> int | None:
        """Return for how many ns the client was idle, if it may be evicted for another; else None."""

    def close(self, reset: bool, why: Message) -> None:
        """End the client."""


class ClientSlot(Enum):
    """Kind of slot that a new client gets."""

    NONE = 0
    REGULAR = 1
    RESERVED = 2
    """A slot reserved for stops."""


class ClientSlots:
    """The slots of one transport."""

    def __init__(self) -> None:
        self._regular: dict[int, Occupant] = {}
        self._reserved: dict[int, Occupant] = {}
        self._fresh: dict[int, Occupant] = {}
        self._sources: Counter[str] = Counter()
        self._replacements_left, self._replaced_at = REPLACE_BURST, 0
        self._exhausted_sources: set[str | None] = set()
        self._exhausted_at = 0

    def __len__(self) -> int:
        return len(self._regular) + len(self._reserved)

    def find_slot(self, host: str, now: int, is_stop: bool) -> ClientSlot:
        """Find a slot for a new client. Others may be evicted for it.

        Args:
            host: Address of the client.
            now: ns of a monotonic clock.
            is_stop: True if its first frame is a stop.
        """
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

    def occupy(self, occupant: Occupant, slot: ClientSlot, is_fresh: bool) -> None:
        """Give a client its slot.

        Args:
            occupant: The client.
            slot: Result of `find_slot`, or `ClientSlot.RESERVED` for a client that must not stay long.
            is_fresh: True if the client has sent one datagram and may never send another.
        """
        number = occupant.number
        if slot is ClientSlot.RESERVED:
            self._reserved[number] = occupant
            return
        self._regular[number] = occupant
        self._sources[occupant.source] += 1
        if is_fresh:
            self._fresh[number] = occupant

    def mark_established(self, number: int) -> None:
        """Note that a fresh client has sent again."""
        self._fresh.pop(number, None)

    def release(self, number: int) -> None:
        """Free the slot of a client that has ended."""
        self._fresh.pop(number, None)
        self._reserved.pop(number, None)
        occupant = self._regular.pop(number, None)
        if occupant is not None:
            source = occupant.source
            self._sources[source] -= 1
            if not self._sources[source]:
                del self._sources[source]

    def end_oldest_stop(self) -> bool:
        """End the client that has held a reserved slot longest. Return whether there was one."""
        oldest = next(iter(self._reserved.values()), None)
        if oldest is None:
            return False
        oldest.close(False, TOO_MANY_CLIENTS)
        self._reserved.pop(oldest.number, None)
        return True

    def _evict_one(self, source: str | None, now: int) -> bool:
        """Evict a client, of one source or of any, that may be evicted. Return whether there was one."""
        victim = self._oldest_replaceable(source, now) or self._longest_idle(source, now)
        if victim is None:
            return False
        victim.close(False, TOO_MANY_CLIENTS)
        self.release(victim.number)
        return True

    def _longest_idle(self, source: str | None, now: int) -> Occupant | None:
        """Return the client that was idle longest, None if there is none.

        A search without result is not repeated for the same `now`.
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

    def _oldest_replaceable(self, source: str | None, now: int) -> Occupant | None:
        """Return the oldest fresh client, of one source or any; None if no eviction is allowed now."""
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
