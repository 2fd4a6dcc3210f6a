"""The calls and the findings of a recording, which may still be written."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import closing, suppress
from pathlib import Path

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, TrafficTotals
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from bcapscope.traffic.call import Call
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber


class RecordedTraffic(PipelineSubscriber):
    """What a recording contains so far.

    Attributes:
        calls: Calls in the order in which they ended, each with the object of its handle. Calls without a
            reply are included.
        findings: Findings of `bcapscope diagnose`, root cause first.
        totals: Figures that the findings refer to.
    """

    needs_targets = True

    def __init__(self, path: Path, ports: Collection[int]) -> None:
        """Read a recording. `ports` are the ports that the controllers in it use.

        Raises:
            CaptureError: The file cannot be opened.
        """
        self.calls: list[tuple[Call, TrackedObject | None]] = []
        diagnosis, decoder = Diagnosis(), PacketDecoder(frozenset(ports))
        pipeline = Pipeline(self, diagnosis, joiner=Joiner(decoder.comments))
        # The last packet may be incomplete, because another thread or process is writing it.
        with closing(open_capture(path)) as capture, suppress(CaptureError):
            for observation in decoder.decode(capture):
                pipeline.add(observation)
        pipeline.finish(decoder.end_time)
        self.findings: list[Finding] = list(diagnosis.findings(decoder.end_time))
        self.totals: TrafficTotals = diagnosis.totals(decoder.end_time)

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self.calls.append((call, target))
