"""Read captures through a pipeline."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.pipeline import CallCollector, Pipeline

_PROGRESS_EVERY = 0x1000
"""Update the progress bar after this many frames; a power of two."""


T = TypeVar("T")


def call_test(call_filter: Filter | None) -> Callable[[Call], bool] | None:
    """Return the test of a filter on calls; None if it selects all."""
    return None if call_filter is None else call_filter.bind(CALL_GETTERS)


def read_filtered_calls(reader: CaptureReader, call_filter: Filter | None) -> Iterator[Call]:
    """Yield the calls that match a filter, each when it ends."""
    collector = CallCollector(call_test(call_filter))
    return read_items(reader, Pipeline(collector), collector.calls)


def read_items(reader: CaptureReader, pipeline: Pipeline, items: list[T]) -> Iterator[T]:
    """Read to the end of the captures. Yield what the subscribers of the pipeline append to `items`, and
    empty it.
    """
    add = pipeline.add
    for observation in reader.observations():
        add(observation)
        if items:
            yield from items
            items.clear()
    pipeline.finish(reader.ended_at)
    yield from items
    items.clear()


def read_to_end(reader: CaptureReader, pipeline: Pipeline) -> None:
    """Read to the end of the captures."""
    add = pipeline.add
    for count, observation in enumerate(reader.observations()):
        add(observation)
        if not count & (_PROGRESS_EVERY - 1):
            reader.show_progress()
    pipeline.finish(reader.ended_at)
