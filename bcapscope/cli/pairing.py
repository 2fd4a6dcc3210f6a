"""The calls of a reading, as they settle."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.cli.reading import Reading
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker

_PAUSE_AFTER = 0x1000
"""Frames between two looks at how far reading has come; a power of two."""


def settle(reading: Reading) -> Iterator[Settled]:
    """Yield calls as they settle, and what belongs to none."""
    tracker = Tracker()
    observe = tracker.observe
    for seen in reading.observations():
        settled = observe(seen)
        if settled:
            yield from settled
    yield from _rest(reading, tracker)


def wanted_calls(reading: Reading, wanted: Filter | None) -> Iterator[Exchange]:
    """Yield the calls of a reading that a filter lets pass."""
    test = None if wanted is None else wanted.bind(CALL_GETTERS)
    for item in settle(reading):
        if isinstance(item, Exchange) and (test is None or test(item)):
            yield item


def follow(
    reading: Reading, look: Callable[[Observation], object], take: Callable[[Settled], object]
) -> None:
    """Read to the end: show `look` each frame, then `take` what has settled by it."""
    tracker = Tracker()
    observe = tracker.observe
    for count, seen in enumerate(reading.observations()):
        look(seen)
        for settled in observe(seen):
            take(settled)
        if not count & (_PAUSE_AFTER - 1):
            reading.pause()
    for settled in _rest(reading, tracker):
        take(settled)


def _rest(reading: Reading, tracker: Tracker) -> Iterator[Settled]:
    """Yield what is open, at the end of all that was captured."""
    yield from tracker.expire(reading.ended)
    yield from tracker.close()
