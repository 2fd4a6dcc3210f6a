"""The screen's interface to the processes that read, search and save traffic."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeAlias, cast

from msgspec import structs

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

_END_TIMEOUT = 2.0  # seconds that the screen waits for a process or thread to end


@dataclass(frozen=True, slots=True)
class SourceProblem:
    """A problem of a proxy or simulator whose traffic the feed reads; "" if an earlier problem is over."""

    reason: str


def watcher_job(folder: Path, recording: Path) -> ReadJob:
    """Return a job for a proxy's watcher; `folder` must exist, and must not contain files of another job."""
    return ReadJob(path=str(recording), follow=True, language=current_language(), folder=str(folder))


FeedUpdate: TypeAlias = ReadProgress | TrafficAnalysis | SearchMatches | SourceProblem
FeedListener = Callable[[FeedUpdate], object]


class TrafficFeed:
    """The traffic of one source. `journal` and `calls` are None until the first report of traffic."""

    def __init__(self, job: ReadJob, reports: BinaryIO | None = None) -> None:
        """Start a process that reads the traffic.

        Args:
            job: Which traffic to read. Without `reports`, the feed chooses the job's folder and language.
            reports: Stream of `ReadProgress` and `TrafficAnalysis` messages from a proxy's watcher. With
                `reports`, the feed starts no reader process.
        """
        self._folder: TemporaryFolder | None = None
        if reports is None:
            self._folder = TemporaryFolder()
            job = structs.replace(job, folder=str(self._folder.path), language=current_language())
        self.job = job
        self.journal: ObservationStore | None = None
        self.calls: CallStore | None = None
        self.progress = ReadProgress()
        self.is_closed = False
        self._listener: FeedListener | None = None
        self._undelivered: dict[type, FeedUpdate] = {}
        self._lock = threading.Lock()
        self._errors = (Path(self.job.folder) / "errors").open("w+b")
        self._reader: subprocess.Popen[bytes] | None = None
        self._searcher: subprocess.Popen[bytes] | None = None
        self._generation = 0
        self._threads: list[threading.Thread] = []
        if reports is None:
            self._reader = self._start_process("reader_process")
            send_message(_pipe(self._reader.stdin), self.job)
            self._start_thread(self._read_reports, self._reader.stdout)
        else:
            # `close` does not wait for this thread, because the thread runs until the proxy ends.
            threading.Thread(target=self._read_reports, args=(reports,), daemon=True, name="feed").start()

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
        """Whether the source is live, so that more traffic can follow at any time."""
        return bool(self.job.interface) or self.job.follow

    @property
    def display_path(self) -> Path:
        """The screen derives proposed file names from this path; ``live.pcapng`` for a temporary capture."""
        path = Path(self.job.path)
        lasts = self.job.path and not path.is_relative_to(cache_root())
        return path if lasts else Path("live.pcapng")

    def subscribe(self, listener: FeedListener) -> None:
        """Call `listener` now with each undelivered update. Later, the thread that publishes an update calls
        `listener` with this update.
        """
        with self._lock:
            self._listener = listener
        for message in self._undelivered.values():
            listener(message)

    def open_journal(self) -> bool:
        """Open the journal and the call store; return False if their files do not exist yet."""
        if self.journal is None:
            folder = Path(self.job.folder)
            try:
                self.journal = ObservationStore(folder)
                self.calls = CallStore(folder, self.journal)
            except OSError:
                self.journal = None
        return self.journal is not None

    def _read_reports(self, stream: BinaryIO) -> None:
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
                # without `pop`, the update would take the position of the older update that it replaces
                self._undelivered.pop(type(message), None)
                self._undelivered[type(message)] = message
        if listener is not None:
            listener(message)

    def search(self, kind: str, expression: str) -> int:
        """Start a search, and return its number. An empty expression ends the current search."""
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
        # if the search process has just died, the next call of `search` starts a new search process
        with suppress(OSError):
            send_message(_pipe(self._searcher.stdin), request)
        return self._generation

    def _read_matches(self, searcher: subprocess.Popen[bytes]) -> None:
        with _pipe(searcher.stdout) as answers:
            for message in receive_messages(answers, SearchMatches):
                self._publish(message)

    def make_save_job(self, target: str, notes: dict[int, str]) -> SaveJob:
        """Return a job that saves the packets read so far. `notes` maps packet numbers to notes."""
        most = 0
        if self.journal is not None and not self.progress.ended and len(self.journal):
            most = self.journal.read_frame(len(self.journal)).observation.packet
        return SaveJob(self.progress.packets, target, notes, most, current_language())

    def save(self, job: SaveJob) -> str:
        """Run a save job; return why saving failed, or "". The method blocks, so use a separate thread."""
        process = self._start_process("save_process")
        send_message(_pipe(process.stdin), job)
        out, _ = process.communicate()
        return out.decode() if process.returncode == 0 else self._last_error_line()

    def stop_reading(self) -> None:
        """Notify the reader that no more traffic will arrive. The reader still reads the remaining data."""
        if self._reader is None:  # the reports come from a proxy's watcher, which ends with the relay
            return
        with suppress(OSError):  # the process has ended
            _pipe(self._reader.stdin).write(STOP_READING)
            _pipe(self._reader.stdin).flush()

    def report_source_problem(self, reason: str) -> None:
        """Report a `SourceProblem`. Any thread may call this method."""
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
    with suppress(OSError):  # the process ended before it read all its input
        _pipe(process.stdin).close()
    process.terminate()
    try:
        process.wait(_END_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _pipe(stream: IO[bytes] | None) -> Any:
    assert stream is not None  # the feed starts all processes with pipes
    return stream
