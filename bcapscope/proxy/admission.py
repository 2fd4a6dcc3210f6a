"""Decides which clients the proxy accepts when there are too many; does no I/O and reads no clock.

Each transport has places of its own, and no address may take all of them. A new client whose first frame is a
stop always gets one: some are kept for that.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum
from operator import itemgetter
from typing import Protocol

from bcapscope.transport.first_frame_queue import source_network

MAX_CLIENTS = 256
"""Clients of each transport, of all listeners; DENSO's C server takes 20 (orin_bcap C/src/bcap_server.c)."""

MAX_PER_SOURCE = 192
"""Clients of one address, behind which a whole plant may be; the rest is enough for three controllers."""

RESERVED_SLOTS = 4
"""Further places of each transport, for clients whose first frame is a stop. The newest of them stay."""

REPLACE_INTERVAL_NS = 5_000_000
"""ns between two changes of places that are all taken: a flood from ever new UDP ports may not cost the relay
more than that."""

REPLACE_BURST = 64
"""Places that may change hands without that delay, after a quiet time."""

TOO_MANY_CLIENTS = "silent, and there are too many clients"
"""Why a client ends that gives its place to another."""


class Occupant(Protocol):
    """A client that has a place."""

    @property
    def number(self) -> int:
        """Its number, never used twice."""

    @property
    def source(self) -> str:
        """Where it comes from; see `source_network`."""

    def evictable_idle_ns(self, now: int) -> int | None:
        """Return the ns for which it has done nothing, if it may give its place to another; else None."""

    def close(self, reset: bool, why: str) -> None:
        """End it."""


class ClientSlot(Enum):
    """A place that a new client gets."""

    NONE = 0
    REGULAR = 1
    RESERVED = 2
    """One of those for stops."""


class ClientSlots:
    """The places of one transport."""

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
        """Find a place for a new client; others may be ended for it.

        Args:
            host: address of the client.
            now: ns of a clock that does not go back.
            is_stop: its first frame is a stop.
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
        """Give a client its place.

        Args:
            occupant: the client.
            slot: that `find_slot` returned, or `RESERVED_SLOTS` for a client that must not stay for long.
            is_fresh: it has only just appeared, and may never speak again.
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
        """Note that a fresh client has spoken again."""
        self._fresh.pop(number, None)

    def release(self, number: int) -> None:
        """Note that a client has ended."""
        self._fresh.pop(number, None)
        self._reserved.pop(number, None)
        occupant = self._regular.pop(number, None)
        if occupant is not None:
            source = occupant.source
            self._sources[source] -= 1
            if not self._sources[source]:
                del self._sources[source]

    def end_oldest_stop(self) -> bool:
        """End the client that has been in a kept place for longest; return whether there was one."""
        oldest = next(iter(self._reserved.values()), None)
        if oldest is None:
            return False
        oldest.close(False, TOO_MANY_CLIENTS)
        self._reserved.pop(oldest.number, None)
        return True

    def _evict_one(self, source: str | None, now: int) -> bool:
        """End a client, of one source or of any, that may give its place up; return whether there was one."""
        victim = self._oldest_replaceable(source, now) or self._longest_idle(source, now)
        if victim is None:
            return False
        victim.close(False, TOO_MANY_CLIENTS)
        self.release(victim.number)
        return True

    def _longest_idle(self, source: str | None, now: int) -> Occupant | None:
        """Return the client that has been quiet for longest; a search that found none is not repeated at
        once."""
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
        """Return the oldest fresh client, of one source or of any, if its place may change hands now."""
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
