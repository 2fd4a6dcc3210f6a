"""The screen's interface to the processes that read, search and save."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeAlias, cast

from bcapscope.capture.call_store import CallStore
from bcapscope.capture.observation_store import ObservationStore
from bcapscope.tui.reader_language import current_language, label
from bcapscope.tui.traffic_processes.process_messages import (
    STOP_READING,
    ReadJob,
    ReadProgress,
    SaveJob,
    SearchMatches,
    SearchRequest,
    TrafficAnalysis,
    receive_messages,
    send_message,
)
from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolder, cache_root

_END_TIMEOUT = 2.0
"""Seconds that a process has to end before it is killed."""


@dataclass(frozen=True, slots=True)
class SourceProblem:
    """It is unknown whether more traffic follows, or none will; "" as `reason` withdraws that."""

    reason: str


@dataclass(frozen=True, slots=True)
class PublishedTraffic:
    """What the watcher of a proxy publishes.

    Attributes:
        job: What it publishes. The folder is not removed with the feed.
        reports: Delivers `ReadProgress` and `TrafficAnalysis`.
    """

    job: ReadJob
    reports: BinaryIO


def watcher_job(folder: Path, recording: Path) -> ReadJob:
    """Return the job of a proxy's watcher; `folder` exists and holds no files of another job."""
    return ReadJob(str(folder), str(recording), follow=True, language=current_language())


FeedUpdate: TypeAlias = ReadProgress | TrafficAnalysis | SearchMatches | SourceProblem
FeedListener = Callable[[FeedUpdate], None]


class TrafficFeed:
    """One source of traffic. It passes reports to listeners in its own thread.

    Attributes:
        journal: All observations; None before the first.
        calls: All settled calls; None before the first.
        is_closed: Whether the data can no longer be read.
    """

    def __init__(
        self,
        *,
        path: str = "",
        interface: str = "",
        follow: bool = False,
        ports: tuple[int, ...] = (),
        leg: str = "",
        own_clients: bool = False,
        published: PublishedTraffic | None = None,
    ):
        """Read a capture or interface, see `ReadJob`, or only what a proxy's watcher has `published`."""
        self._folder: TemporaryFolder | None = None
        if published is None:
            self._folder = TemporaryFolder()
            folder = str(self._folder.path)
            self.job = ReadJob(folder, path, interface, follow, ports, leg, current_language(), own_clients)
        else:
            self.job = published.job
        self.journal: ObservationStore | None = None
        self.calls: CallStore | None = None
        self.progress = ReadProgress()
        self.is_closed = False
        self._listener: FeedListener | None = None
        self._undelivered: list[FeedUpdate] = []
        self._lock = threading.Lock()
        self._errors = (Path(self.job.folder) / "errors").open("w+b")
        self._reader: subprocess.Popen[bytes] | None = None
        self._searcher: subprocess.Popen[bytes] | None = None
        self._generation = 0
        self._threads: list[threading.Thread] = []
        if published is None:
            self._reader = self._start_process("reader_process")
            send_message(_pipe(self._reader.stdin), self.job)
            self._start_thread(self._read_reports, self._reader.stdout)
        else:
            threading.Thread(
                target=self._read_reports, args=(published.reports,), daemon=True, name="feed"
            ).start()  # it ends with the proxy, after `close`

    def _start_thread(self, target: Callable[..., None], *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True, name="feed")
        self._threads.append(thread)
        thread.start()

    def _start_process(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        argv = [sys.executable, "-m", f"bcapscope.tui.traffic_processes.{module}", *words]
        return subprocess.Popen(
            argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, start_new_session=True
        )

    @property
    def is_live(self) -> bool:
        """Whether more traffic can follow at any time."""
        return bool(self.job.interface) or self.job.follow

    @property
    def display_path(self) -> Path:
        """The capture, as a basis for names of new files; ``live.pcapng`` for a temporary capture."""
        path = Path(self.job.path)
        lasts = self.job.path and not path.is_relative_to(cache_root())
        return path if lasts else Path("live.pcapng")

    def subscribe(self, listener: FeedListener) -> None:
        """Pass all updates to `listener`, in another thread; past updates are passed at once."""
        with self._lock:
            self._listener = listener
            waiting, self._undelivered = self._undelivered, []
        for message in waiting:
            listener(message)

    def open_journal(self) -> bool:
        """Open the journal; return whether it exists yet."""
        if self.journal is None:
            folder = Path(self.job.folder)
            try:
                self.journal = ObservationStore(folder)
                self.calls = CallStore(folder, self.journal)
            except OSError:
                self.journal = None
        return self.journal is not None

    def _read_reports(self, stream: BinaryIO) -> None:
        """Forward the reports, and report if they end without a final one."""
        ended = False
        kind = cast("type[ReadProgress | TrafficAnalysis]", ReadProgress | TrafficAnalysis)
        with stream as reports:
            for message in receive_messages(reports, kind):
                ended = isinstance(message, ReadProgress) and message.ended
                self._publish(message)
        if not ended:
            problem = self._last_error_line() if self._reader is not None else ""
            self._publish(ReadProgress(ended=True, problem=problem, packets=self.job.path))

    def _last_error_line(self) -> str:
        self._errors.seek(0)
        *_, last = self._errors.read().decode(errors="replace").splitlines() or [label("traffic.reader-gone")]
        return last

    def _publish(self, message: FeedUpdate) -> None:
        with self._lock:
            listener = self._listener
            if listener is None:
                self._undelivered.append(message)
        if listener is not None:
            listener(message)

    def search(self, kind: str, expression: str) -> int:
        """Search for matching rows ("" ends the search); return the generation of the matches."""
        self._generation += 1
        request = SearchRequest(self._generation, kind, expression)
        if self._searcher is not None and self._searcher.poll() is not None:
            _end_process(self._searcher)
            self._searcher = None
        if self._searcher is None:
            if not expression:
                return self._generation
            self._searcher = self._start_process("search_process", self.job.folder)
            self._start_thread(self._read_matches, self._searcher)
        with suppress(OSError):  # it died just now; the next search starts it again
            send_message(_pipe(self._searcher.stdin), request)
        return self._generation

    def _read_matches(self, searcher: subprocess.Popen[bytes]) -> None:
        with _pipe(searcher.stdout) as answers:
            for message in receive_messages(answers, SearchMatches):
                self._publish(message)

    def make_save_job(self, target: str, notes: dict[int, str]) -> SaveJob:
        """Return the job that saves all packets seen so far with notes by packet number, in a new file."""
        most = 0
        if self.journal is not None and not self.progress.ended and len(self.journal):
            most = self.journal.read_frame(len(self.journal)).observation.packet
        return SaveJob(self.progress.packets, target, notes, most, current_language())

    def save(self, job: SaveJob) -> str:
        """Run a save job; return why it failed, or "". This blocks: call it from a separate thread."""
        process = self._start_process("save_process")
        send_message(_pipe(process.stdin), job)
        out, _ = process.communicate()
        return out.decode() if process.returncode == 0 else self._last_error_line()

    def stop_reading(self) -> None:
        """Treat the source as ended; the reader still processes the data that exists.

        The watcher of a proxy ends with its relay, and needs no order.
        """
        if self._reader is None:
            return
        with suppress(OSError):  # the process has ended
            _pipe(self._reader.stdin).write(STOP_READING)
            _pipe(self._reader.stdin).flush()

    def report_source_problem(self, reason: str) -> None:
        """Report why no more traffic may follow (one sentence; "" withdraws it). Any thread may call."""
        self._publish(SourceProblem(reason))

    def close(self) -> None:
        self.is_closed = True
        self._listener = lambda message: None
        for process in (self._reader, self._searcher):
            if process is not None:
                _end_process(process)
        if self.journal is not None:
            self.journal.close()
        if self.calls is not None:
            self.calls.close()
        for thread in self._threads:
            thread.join(_END_TIMEOUT)
        self._errors.close()
        if self._folder is not None:
            self._folder.close()


def _end_process(process: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):  # it ended before it had read everything
        _pipe(process.stdin).close()
    process.terminate()
    try:
        process.wait(_END_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _pipe(stream: IO[bytes] | None) -> Any:
    """Return a process's pipe, which exists because the process was started with one."""
    assert stream is not None
    return stream
