"""The calls and the findings of a recording that may still grow, and the report of a failed test."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, TrafficTotals
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.capture_input import CaptureInput
from bcapscope.messages import ENGLISH_WORDS
from bcapscope.messages.places import Count
from bcapscope.render.call_text import CallRenderer
from bcapscope.render.escape import printable
from bcapscope.render.findings import FindingsRenderer
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.pipeline import PipelineSubscriber


class RecordedTraffic(PipelineSubscriber):
    """The calls and findings of a recording. The order of `calls` is the order in which the calls ended."""

    needs_targets = True

    def __init__(self, path: Path, ports: Collection[int]) -> None:
        """`ports` are those of controllers. Raises CaptureError if the file cannot be opened."""
        open_capture(path).close()
        self.calls: list[tuple[Call, TrackedObject | None]] = []
        # The last packet may be incomplete, because another thread or process is writing it.
        source = CaptureInput([str(path)], ports, on_problem=lambda path, error: None)
        diagnosis = Diagnosis()
        for _ in source.read_items(source.pipeline(self, diagnosis), []):
            pass
        self.findings: list[Finding] = list(diagnosis.findings(source.ended_at))
        self.totals: TrafficTotals = diagnosis.totals(source.ended_at)

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self.calls.append((call, target))


MAX_CALLS = 30  # maximum number of calls in a report; earlier calls of the test are only counted


def failure_report_lines(traffic: RecordedTraffic, recording: Path) -> Iterator[str]:
    words, calls = ENGLISH_WORDS, traffic.calls
    renderer = CallRenderer()
    if calls:
        renderer.set_time_origin(traffic.totals.began)
    earlier = len(calls) - MAX_CALLS
    if earlier > 0:
        yield words("testing.report.earlier", calls=Count(earlier, "call"))
    for call, target in calls[-MAX_CALLS:]:
        yield renderer.line(call, target)
    yield ""
    yield from FindingsRenderer().lines(traffic.findings, traffic.totals)
    yield ""
    yield words("testing.report.capture", path=printable(str(recording)))
