"""Decides which clients the proxy accepts when there are too many; does no I/O and reads no clock.

Each transport has places of its own, and no address may take all of them. A new client whose first frame is a
stop always gets one: some are kept for that.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum
from operator import itemgetter
from typing import Protocol

from bcapscope.transport.lobby import source_of

MOST_CLIENTS = 256
"""Clients of each transport, of all listeners; DENSO's C server takes 20 (orin_bcap C/src/bcap_server.c)."""

MOST_OF_ONE = 192
"""Clients of one address, behind which a whole plant may be; the rest is enough for three controllers."""

KEPT = 4
"""Further places of each transport, for clients whose first frame is a stop. The newest of them stay."""

RENEWED_EACH = 5_000_000
"""ns between two changes of places that are all taken: a flood from ever new UDP ports may not cost the relay
more than that."""

RENEWED_AT_ONCE = 64
"""Places that may change hands without that delay, after a quiet time."""

CROWDED = "silent, and there are too many clients"
"""Why a client ends that gives its place to another."""


class Occupant(Protocol):
    """A client that has a place."""

    @property
    def number(self) -> int:
        """Its number, never used twice."""

    @property
    def source(self) -> str:
        """Where it comes from; see `source_of`."""

    def quiet(self, now: int) -> int | None:
        """Return the ns for which it has done nothing, if it may give its place to another; else None."""

    def close(self, reset: bool, why: str) -> None:
        """End it."""


class Place(Enum):
    """A place that a new client gets."""

    NONE = 0
    USUAL = 1
    KEPT = 2
    """One of those for stops."""


class Places:
    """The places of one transport."""

    def __init__(self) -> None:
        self._usual: dict[int, Occupant] = {}
        self._kept: dict[int, Occupant] = {}
        self._fresh: dict[int, Occupant] = {}
        self._sources: Counter[str] = Counter()
        self._renewals, self._renewed_at = RENEWED_AT_ONCE, 0
        self._futile: set[str | None] = set()
        self._futile_at = 0

    def __len__(self) -> int:
        return len(self._usual) + len(self._kept)

    def find(self, host: str, now: int, is_stop: bool) -> Place:
        """Find a place for a new client; others may be ended for it.

        Args:
            host: address of the client.
            now: ns of a clock that does not go back.
            is_stop: its first frame is a stop.
        """
        source = source_of(host)
        if self._sources[source] >= MOST_OF_ONE:
            found = self._clears(source, now)
        else:
            found = len(self._usual) < MOST_CLIENTS or self._clears(None, now)
        if found:
            return Place.USUAL
        if not is_stop:
            return Place.NONE
        if len(self._kept) >= KEPT:
            self.end_oldest_stop()
        return Place.KEPT

    def take(self, occupant: Occupant, place: Place, is_fresh: bool) -> None:
        """Give a client its place.

        Args:
            occupant: the client.
            place: that `find` returned, or `KEPT` for a client that must not stay for long.
            is_fresh: it has only just appeared, and may never speak again.
        """
        number = occupant.number
        if place is Place.KEPT:
            self._kept[number] = occupant
            return
        self._usual[number] = occupant
        self._sources[occupant.source] += 1
        if is_fresh:
            self._fresh[number] = occupant

    def settle(self, number: int) -> None:
        """Note that a fresh client has spoken again."""
        self._fresh.pop(number, None)

    def leave(self, number: int) -> None:
        """Note that a client has ended."""
        self._fresh.pop(number, None)
        self._kept.pop(number, None)
        occupant = self._usual.pop(number, None)
        if occupant is not None:
            source = occupant.source
            self._sources[source] -= 1
            if not self._sources[source]:
                del self._sources[source]

    def end_oldest_stop(self) -> bool:
        """End the client that has been in a kept place for longest; return whether there was one."""
        oldest = next(iter(self._kept.values()), None)
        if oldest is None:
            return False
        oldest.close(False, CROWDED)
        self._kept.pop(oldest.number, None)
        return True

    def _clears(self, source: str | None, now: int) -> bool:
        """End a client, of one source or of any, that may give its place up; return whether there was one."""
        victim = self._renewable(source, now) or self._quietest(source, now)
        if victim is None:
            return False
        victim.close(False, CROWDED)
        self.leave(victim.number)
        return True

    def _quietest(self, source: str | None, now: int) -> Occupant | None:
        """Return the client that has been quiet for longest; a search that found none is not repeated at
        once."""
        if now != self._futile_at:
            self._futile_at = now
            self._futile.clear()
        if source in self._futile:
            return None
        candidates = (each for each in self._usual.values() if source in (None, each.source))
        quiet = ((each.quiet(now), each) for each in candidates)
        found = [(length, each) for length, each in quiet if length is not None]
        if found:
            return max(found, key=itemgetter(0))[1]
        self._futile.add(source)
        return None

    def _renewable(self, source: str | None, now: int) -> Occupant | None:
        """Return the oldest fresh client, of one source or of any, if its place may change hands now."""
        earned = (now - self._renewed_at) // RENEWED_EACH
        if earned:
            self._renewals = min(self._renewals + earned, RENEWED_AT_ONCE)
            self._renewed_at = now
        if not self._renewals:
            return None
        fresh = (each for each in self._fresh.values() if source in (None, each.source))
        victim = next(fresh, None)
        self._renewals -= victim is not None
        return victim
