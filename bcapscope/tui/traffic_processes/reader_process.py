"""The reader process, which writes observations to a journal and calls to a call store, and analyses the
traffic. The job arrives on standard input; reports go to standard output. The screen sends `STOP_READING`
when no more traffic will arrive. When the reader's standard input is closed, reading ends at once.
"""

from __future__ import annotations

import gc
import io
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import BinaryIO, cast

from bcapscope.capture.capture_file import CaptureFile, follow_capture, open_capture
from bcapscope.capture.live_capture import open_live_capture
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.capture.role_detection import BCAP_PORTS
from bcapscope.capture.rotating_recording import RotatingRecording
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.pipeline import Pipeline
from bcapscope.tui.traffic_processes.process_messages import (
    ReadJob,
    ReadProgress,
    begin_process,
    problem_text,
    receive_messages,
    send_message,
)
from bcapscope.tui.traffic_processes.traffic_publisher import TrafficPublisher

_BATCH_MASK = 0xFF  # mask for frame numbers: the reader checks the clock every 256 frames

LIVE_FILE = "live.pcapng"


class TrafficReader:
    def __init__(
        self, job: ReadJob, reports: BinaryIO, ended: threading.Event, cancelled: threading.Event
    ) -> None:
        """After `ended` is set, the reader reads the remaining data; after `cancelled` is set, it stops."""
        self._job = job
        self._source_ended, self._cancelled = ended, cancelled
        folder = Path(job.folder)
        self._publisher = TrafficPublisher(job, partial(send_message, reports), self._make_progress)
        self._observer = PacketDecoder(frozenset(job.ports) or BCAP_PORTS, job.leg)
        self._pipeline: Pipeline | None = None
        self._has_ended = False
        self._problem: Message | None = None
        self._undiagnosed: list[Observation] = []
        self._analyse = self._undiagnosed.append
        self._file: CaptureFile | None = None
        self._live = _LiveCapture(job.interface, folder / LIVE_FILE) if job.interface else None
        self._packet_file = str(folder / LIVE_FILE) if job.interface else job.path
        self._last_capture_time = self._last_capture_seen_at = 0

    def run(self) -> None:
        with closing(self._publisher):
            try:
                self._read()
            except CaptureError as error:
                self._problem = error.message
            except OSError as error:
                self._problem = os_reason(error)
            end = self._observer.end_time
            self._load_pipeline().finish(end)
            self._has_ended = True
            self._publisher.report_end(end)

    def _read(self) -> None:
        kind_of, comments = RecentRequests().kind_of, self._observer.comments
        add_to_journal = self._publisher.journal.add
        for seen in self._observer.decode(self._open_source()):
            add_to_journal(seen, kind_of(seen), comments.get(seen.packet, ()) if comments else ())
            self._analyse(seen)
            if not seen.number & _BATCH_MASK:
                if self._pipeline is None:
                    self._publisher.report_progress()
                    self._load_pipeline()
                self._publisher.report_if_due(self._observer.end_time)
                if self._cancelled.is_set():
                    return

    def _load_pipeline(self) -> Pipeline:
        """Load pipeline and diagnosis at their first use, so that the first frames appear sooner."""
        if self._pipeline is None:
            joiner = Joiner(self._observer.comments)
            subscribers, taken_at = self._publisher.subscribers(), self._job.taken_at
            self._pipeline = Pipeline(*subscribers, joiner=joiner, taken_at=taken_at)
            self._analyse = self._pipeline.add
            for observation in self._undiagnosed:
                self._analyse(observation)
            self._undiagnosed.clear()
        return self._pipeline

    def _open_source(self) -> Iterator[Packet]:
        if self._live is not None:
            self._live.start(self._source_ended)
            path, follow = self._live.path, True
        else:
            path, follow = Path(self._job.path), self._job.follow
        with (
            follow_capture(path, self._source_ended, self._on_idle)
            if follow
            else open_capture(path) as self._file
        ):
            yield from self._file
        if self._live is not None and self._live.problem is not None:
            raise self._live.problem

    def _on_idle(self) -> None:
        """Complete the open calls that are too old to receive a reply."""
        if self._live is not None and self._live.problem is not None:
            self._source_ended.set()
        if self._publisher.journal.count:
            self._load_pipeline().expire(self._capture_time())
        self._publisher.report_if_due(self._observer.end_time)

    def _capture_time(self) -> int:
        """Return the present time in ns, by the clock of the computer that captured the packets."""
        latest, now = self._observer.end_time, time.monotonic_ns()
        if latest != self._last_capture_time:
            self._last_capture_time, self._last_capture_seen_at = latest, now
        return latest + now - self._last_capture_seen_at

    def _make_progress(self) -> ReadProgress:
        file = self._file
        return ReadProgress(
            position=file.position if file is not None else 0,
            size=(file.size or 0) if file is not None else 0,
            ended=self._has_ended,
            problem=problem_text(self._problem, self._job),
            clients=len(self._observer.conversations),
            packets=self._packet_file,
            lost=self._live.lost if self._live is not None else 0,
        )


class _LiveCapture:
    def __init__(self, interface: str, path: Path) -> None:
        self.path = path
        self.problem: CaptureError | None = None
        self.lost = 0
        self._interface = interface
        self._recording = RotatingRecording(path)

    def start(self, ended: threading.Event) -> None:
        threading.Thread(target=self._run, args=(ended,), daemon=True, name="capture").start()

    def _run(self, ended: threading.Event) -> None:
        try:
            with closing(self._recording), open_live_capture(self._interface) as capture:
                for packet in capture:
                    self._recording.recording.write_packet(packet)
                    self._recording.flush()
                    self.lost = capture.lost
                    if ended.is_set():
                        return
        except CaptureError as error:
            self.problem = error
        except OSError as error:
            self.problem = CaptureError(Message("capture.cannot-keep", reason=os_reason(error)))


def main() -> None:
    begin_process()
    # A thread that reads `sys.stdin` would still hold the lock of `sys.stdin` at exit. `FileIO` has no lock.
    stdin = io.FileIO(0, closefd=False)
    job = next(receive_messages(stdin, ReadJob), None)
    if job is None:
        return
    ended, cancelled = threading.Event(), threading.Event()

    def wait_for_the_end() -> None:
        while stdin.read(1):
            ended.set()
        cancelled.set()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True, name="end").start()
    gc.freeze()
    # frames and calls contain no reference cycles, so frequent collections are useless
    gc.set_threshold(20_000, 20, 100)
    try:
        TrafficReader(job, cast(BinaryIO, sys.stdout.buffer), ended, cancelled).run()
    except BrokenPipeError:  # the screen has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
