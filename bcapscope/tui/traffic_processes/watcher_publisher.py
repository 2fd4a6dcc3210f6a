"""Publishes traffic from the watcher of a proxy to the screen that started the proxy. The watcher writes the
same kinds of files as the reader process. The relay first writes its addresses to
standard output; then the reports follow there.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from contextlib import suppress

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.messages.os_errors import os_reason
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.observation import Observation
from bcapscope.tui.traffic_processes.process_messages import (
    ReadJob,
    ReadProgress,
    TrafficAnalysis,
    problem_text,
    send_message,
)
from bcapscope.tui.traffic_processes.traffic_publisher import TrafficPublisher

_SENT_WITHIN = 2.0  # seconds for sending the last reports


class ReportSender:
    """Sends the latest report of each kind in a separate thread, so that a slow screen delays no traffic."""

    def __init__(self, stream: io.RawIOBase) -> None:
        self._stream = stream
        self._waiting: dict[type, ReadProgress | TrafficAnalysis] = {}
        self._changed = threading.Condition()
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name="reports", daemon=True)
        self._thread.start()

    def send(self, report: ReadProgress | TrafficAnalysis) -> None:
        with self._changed:
            # the old report is removed first, so that the new report goes to the end of the queue
            self._waiting.pop(type(report), None)
            self._waiting[type(report)] = report
            self._changed.notify()

    def close(self) -> None:
        """Send the remaining reports within `_SENT_WITHIN` seconds."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._thread.join(_SENT_WITHIN)

    def _run(self) -> None:
        is_last = False
        with suppress(OSError):  # the screen has gone
            while not is_last:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting or self._is_closing)
                    reports, self._waiting = self._waiting, {}
                    is_last = self._is_closing
                for report in reports.values():
                    send_message(self._stream, report)


class WatcherPublisher:
    """Publishes what the watcher decodes, until a file cannot be written."""

    def __init__(self, job: ReadJob, sender: ReportSender) -> None:
        """Create the files for the screen; raises `OSError` if creating them fails."""
        self._job = job
        self._sender = sender
        self._publisher = TrafficPublisher(job, sender.send, self._make_progress)
        self.diagnosis: Diagnosis = self._publisher.load_diagnosis().diagnosis
        self.subscribers = self._publisher.subscribers()
        self._call_kind_of = RecentRequests().kind_of
        self._client_count = 0
        self._has_ended, self._problem = False, ""

    def on_frame(self, observation: Observation, note: str) -> None:
        """`note` says how the proxy changed the frame; "" for an unchanged frame."""
        kind = self._call_kind_of(observation)
        self._publish(self._publisher.journal.add, observation, kind, (note,) if note else ())

    def report_if_due(self, client_count: int) -> None:
        self._client_count = client_count
        if client_count:
            self._publish(self._publisher.report_if_due, 0)

    def close(self, end_time: int) -> None:
        """Report the end of the traffic at `end_time` (ns since 1970), and close the files."""
        if self._client_count:
            self._publish(self._report_end, end_time)
        self._sender.close()
        self._publisher.close()

    def _report_end(self, end_time: int) -> None:
        self._has_ended = True
        self._publisher.report_end(end_time)

    def _publish(self, action: Callable[..., object], *arguments: object) -> None:
        """Run an action that publishes. If the action fails, report the error and publish nothing more."""
        if self._has_ended:
            return
        try:
            action(*arguments)
        except OSError as error:
            self._has_ended, self._problem = True, problem_text(os_reason(error), self._job)
            self._publisher.call_recorder.is_active = False
            self._sender.send(self._make_progress())

    def _make_progress(self) -> ReadProgress:
        return ReadProgress(
            ended=self._has_ended, problem=self._problem, clients=self._client_count, packets=self._job.path
        )
