"""Read the calls in captures, each when it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker

_PROGRESS_EVERY = 0x1000
"""Update the progress bar after this many frames; a power of two."""


def read_calls(reader: CaptureReader) -> Iterator[PairingResult]:
    """Yield each call when it ends, and stray replies."""
    tracker = Tracker()
    observe = tracker.observe
    for seen in reader.observations():
        settled = observe(seen)
        if settled:
            yield from settled
    yield from _close_open_calls(reader, tracker)


def read_filtered_calls(reader: CaptureReader, call_filter: Filter | None) -> Iterator[Call]:
    test = None if call_filter is None else call_filter.bind(CALL_GETTERS)
    for item in read_calls(reader):
        if isinstance(item, Call) and (test is None or test(item)):
            yield item


def read_to_end(
    reader: CaptureReader,
    on_frame: Callable[[Observation], object],
    on_settled: Callable[[PairingResult], object],
) -> None:
    """Read to the end: pass each frame to `on_frame`, then the calls that it ended to `on_settled`."""
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
    yield from tracker.expire(reader.ended_at)
    yield from tracker.close()
