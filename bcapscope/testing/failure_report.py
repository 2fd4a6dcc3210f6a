"""The b-CAP section in the report of a failed test: calls, findings and the path of the capture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bcapscope.messages import ENGLISH_WORDS
from bcapscope.messages.places import Count
from bcapscope.render.call_text import CallRenderer
from bcapscope.render.escape import printable
from bcapscope.render.findings import FindingsRenderer
from bcapscope.testing.recorded_traffic import RecordedTraffic

MAX_CALLS = 30
"""Maximum number of calls in a report. The report shows the last calls of the test."""


def failure_report_lines(traffic: RecordedTraffic, recording: Path) -> Iterator[str]:
    """Yield the last calls, the findings of `diagnose`, and the path of the capture."""
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
