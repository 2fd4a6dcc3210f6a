"""The calls of a reading, as they settle."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker

_PROGRESS_EVERY = 0x1000
"""Frames between two looks at how far reading has come; a power of two."""


def read_calls(reader: CaptureReader) -> Iterator[PairingResult]:
    """Yield calls as they settle, and what belongs to none."""
    tracker = Tracker()
    observe = tracker.observe
    for seen in reader.observations():
        settled = observe(seen)
        if settled:
            yield from settled
    yield from _close_open_calls(reader, tracker)


def read_filtered_calls(reader: CaptureReader, call_filter: Filter | None) -> Iterator[Call]:
    """Yield the calls of a reading that a filter lets pass."""
    test = None if call_filter is None else call_filter.bind(CALL_GETTERS)
    for item in read_calls(reader):
        if isinstance(item, Call) and (test is None or test(item)):
            yield item


def read_to_end(
    reader: CaptureReader,
    on_frame: Callable[[Observation], object],
    on_settled: Callable[[PairingResult], object],
) -> None:
    """Read to the end: show `on_frame` each frame, then `on_settled` what has settled by it."""
    tracker = Tracker()
    observe = tracker.observe
    for count, seen in enumerate(reader.observations()):
        on_frame(seen)
        for settled in observe(seen):
            on_settled(settled)
        if not count & (_PROGRESS_EVERY - 1):
            reader.show_progress()
    for settled in _close_open_calls(reader, tracker):
        on_settled(settled)


def _close_open_calls(reader: CaptureReader, tracker: Tracker) -> Iterator[PairingResult]:
    """Yield what is open, at the end of all that was captured."""
    yield from tracker.expire(reader.ended_at)
    yield from tracker.close()
