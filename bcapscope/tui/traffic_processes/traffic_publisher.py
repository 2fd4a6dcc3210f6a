"""Publish traffic for the screen: write frames and calls to files, and send reports."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from bcapscope.capture.call_store import CallStoreWriter
from bcapscope.capture.observation_store import ObservationStoreWriter
from bcapscope.messages import Language, MessageFormatter
from bcapscope.traffic.call import Call, StrayReply
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.pipeline import PipelineSubscriber
from bcapscope.tui.traffic_processes.process_messages import ReadJob, ReadProgress, TrafficAnalysis

if TYPE_CHECKING:
    from bcapscope.tui.traffic_processes.running_diagnosis import RunningDiagnosis

FLUSH_INTERVAL = 0.1
"""Minimum time in seconds between two reports of new frames. Each report makes the screen draw lines again,
and the screen handles no keys meanwhile.
"""

ANALYSIS_INTERVAL = 1.5
"""Minimum time in seconds between two reports of the analysis."""


class CallRecorder(PipelineSubscriber):
    needs_targets = True

    def __init__(self, calls: CallStoreWriter) -> None:
        self.is_active = True
        self._calls = calls

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if self.is_active:
            self._calls.add(call, target)

    def on_stray_reply(self, stray: StrayReply) -> None:
        if self.is_active:
            self._calls.add(stray, None)


class TrafficPublisher:
    def __init__(
        self,
        job: ReadJob,
        send: Callable[[ReadProgress | TrafficAnalysis], object],
        make_progress: Callable[[], ReadProgress],
    ) -> None:
        """Create the journal and the call store; raises `OSError` if creating them fails."""
        folder = Path(job.folder)
        self.journal = ObservationStoreWriter(folder)
        self._calls = CallStoreWriter(folder)
        self.call_recorder = CallRecorder(self._calls)
        self._job = job
        self._send = send
        self._make_progress = make_progress
        self._diagnosis: RunningDiagnosis | None = None
        self._last_flush = self._last_analysis = time.monotonic()
        self._last_analysis_count = 0

    def load_diagnosis(self) -> RunningDiagnosis:
        """Load the diagnosis at its first use, so that the first frames appear sooner."""
        if self._diagnosis is None:
            from bcapscope.tui.traffic_processes.running_diagnosis import (  # noqa: PLC0415 - loads numpy
                RunningDiagnosis,
            )

            self._diagnosis = RunningDiagnosis(MessageFormatter(Language(self._job.language)))
        return self._diagnosis

    def subscribers(self) -> tuple[PipelineSubscriber, ...]:
        return self.call_recorder, *self.load_diagnosis().subscribers

    def report_progress(self) -> None:
        self.journal.flush()
        self._calls.flush()
        self._send(self._make_progress())
        self._last_flush = time.monotonic()

    def report_if_due(self, end_time: int) -> None:
        """Report progress and analysis if their intervals have passed. The analysis assumes that the traffic
        ends at `end_time` (ns since 1970), or with the last frame if that frame is later.
        """
        now = time.monotonic()
        if now - self._last_flush < FLUSH_INTERVAL:
            return
        self.report_progress()
        seen = self.journal.count + self._calls.count
        if now - self._last_analysis >= ANALYSIS_INTERVAL and seen != self._last_analysis_count:
            self._send(self.load_diagnosis().snapshot(end_time, self._job.own_clients))
            self._last_analysis, self._last_analysis_count = time.monotonic(), seen

    def report_end(self, end_time: int) -> None:
        self.journal.flush()
        self._calls.flush()
        self._send(self.load_diagnosis().snapshot(end_time, self._job.own_clients))
        self._send(self._make_progress())

    def close(self) -> None:
        self.journal.close()
        self._calls.close()
