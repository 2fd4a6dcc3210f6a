"""Read captures through a pipeline."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.capture.capture_input import read_items
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.pipeline import CallCollector, Pipeline

_PROGRESS_EVERY = 0x1000
"""Number of frames between updates of the progress bar; a power of two."""


def call_test(call_filter: Filter | None, reader: CaptureReader) -> Callable[[Call], bool] | None:
    """Return a function that tests whether a call matches the filter; None if there is no filter.

    If no call matches the filter, the summary that `reader` prints reports this.
    """
    if call_filter is None:
        return None
    test = call_filter.bind(CALL_GETTERS, lambda: reader.first_time)
    return reader.counting_test(call_filter, test, lambda call: call.number)


def read_filtered_calls(reader: CaptureReader, call_filter: Filter | None) -> Iterator[Call]:
    """Yield each call that matches a filter, as soon as the call is complete."""
    collector = CallCollector(call_test(call_filter, reader))
    return read_items(reader, reader.pipeline(collector), collector.calls)


def read_to_end(reader: CaptureReader, pipeline: Pipeline) -> None:
    """Read the captures to their end, and pass the traffic to the pipeline. Show the progress of this."""
    add = pipeline.add
    for count, observation in enumerate(reader.observations()):
        add(observation)
        if not count & (_PROGRESS_EVERY - 1):
            reader.show_progress()
    pipeline.finish(reader.ended_at)
