"""The screen's side of the processes that read, search and save."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeAlias, cast

from bcapscope.capture.callbook import Callbook
from bcapscope.capture.journal import Journal
from bcapscope.tui.traffic.folder import Folder, place
from bcapscope.tui.traffic.report import (
    STOP,
    Ask,
    Job,
    Matches,
    Progress,
    Saving,
    Verdict,
    receive,
    send,
)
from bcapscope.tui.words import spoken

_GRACE = 2.0
"""Seconds that a process is given to end by itself."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """Whether more will come is not known, or it will not.

    Attributes:
        why: one sentence; "" once there is no doubt any more.
    """

    why: str


News: TypeAlias = Progress | Verdict | Matches | Doubt
Told = Callable[[News], None]


class Feed:
    """One source of traffic: starts reading at once, and hands on what is told in a thread of its own.

    Attributes:
        job: what is read.
        journal: what was seen; None until there is anything.
        calls: what settled; None until there is anything.
        progress: what was told last.
        is_closed: nothing of it can be read any more.
    """

    def __init__(
        self,
        *,
        path: str = "",
        interface: str = "",
        follow: bool = False,
        ports: tuple[int, ...] = (),
        leg: str = "",
        own: bool = False,
    ):
        """Begin to read a capture, finished or still being written, or on an interface; see `Job`."""
        self._folder = Folder()
        self.job = Job(str(self._folder.path), path, interface, follow, ports, leg, spoken(), own)
        self.journal: Journal | None = None
        self.calls: Callbook | None = None
        self.progress = Progress()
        self.is_closed = False
        self._tell: Told | None = None
        self._waiting: list[News] = []
        self._lock = threading.Lock()
        self._errors = (self._folder.path / "errors").open("w+b")
        self._reader = self._start("reading")
        self._searcher: subprocess.Popen[bytes] | None = None
        self._asks = 0
        self._threads: list[threading.Thread] = []
        send(_pipe(self._reader.stdin), self.job)
        self._listen(self._hear)

    def _listen(self, hear: Callable[..., None], *words: object) -> None:
        thread = threading.Thread(target=hear, args=words, daemon=True, name="feed")
        self._threads.append(thread)
        thread.start()

    def _start(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        argv = [sys.executable, "-m", f"bcapscope.tui.traffic.{module}", *words]
        return subprocess.Popen(
            argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, start_new_session=True
        )

    @property
    def is_live(self) -> bool:
        """Whether more may be seen at any time."""
        return bool(self.job.interface) or self.job.follow

    @property
    def name(self) -> Path:
        """The capture that is read, for names of others; what lies where it will be removed has none."""
        path = Path(self.job.path)
        lasts = self.job.path and not path.is_relative_to(place())
        return path if lasts else Path("live.pcapng")

    def attach(self, tell: Told) -> None:
        """Have everything told to `tell`, in another thread; what came before is told now."""
        with self._lock:
            self._tell = tell
            waiting, self._waiting = self._waiting, []
        for message in waiting:
            tell(message)

    def open(self) -> bool:
        """Open the journal, if there is one by now."""
        if self.journal is None:
            try:
                self.journal = Journal(self._folder.path)
                self.calls = Callbook(self._folder.path, self.journal)
            except OSError:
                self.journal = None
        return self.journal is not None

    def _hear(self) -> None:
        """Hand on what the reader tells; tell if it ends without having said so."""
        ended = False
        kind = cast("type[Progress | Verdict]", Progress | Verdict)
        with _pipe(self._reader.stdout) as reports:
            for message in receive(reports, kind):
                ended = isinstance(message, Progress) and message.ended
                self._pass(message)
        if not ended:
            self._pass(Progress(ended=True, trouble=self._last_words()))

    def _last_words(self) -> str:
        self._errors.seek(0)
        *_, last = self._errors.read().decode(errors="replace").splitlines() or ["reading ended"]
        return last

    def _pass(self, message: News) -> None:
        with self._lock:
            tell = self._tell
            if tell is None:
                self._waiting.append(message)
        if tell is not None:
            tell(message)

    def ask(self, kind: str, expression: str) -> int:
        """Search for what fits an expression; "" ends the search.

        Returns:
            The number that `Matches` will have as their generation.
        """
        self._asks += 1
        ask = Ask(self._asks, kind, expression)
        if self._searcher is not None and self._searcher.poll() is not None:
            _end(self._searcher)
            self._searcher = None
        if self._searcher is None:
            if not expression:
                return self._asks
            self._searcher = self._start("searching", str(self._folder.path))
            self._listen(self._hear_matches, self._searcher)
        with suppress(OSError):  # it died in this moment; what is asked next begins it anew
            send(_pipe(self._searcher.stdin), ask)
        return self._asks

    def _hear_matches(self, searcher: subprocess.Popen[bytes]) -> None:
        with _pipe(searcher.stdout) as answers:
            for message in receive(answers, Matches):
                self._pass(message)

    def saving(self, target: str, notes: dict[int, str]) -> Saving:
        """Say what is to be saved: all packets seen by now, with notes by packet, in a new file."""
        most = 0
        if self.journal is not None and not self.progress.ended and len(self.journal):
            most = self.journal.told(len(self.journal)).seen.packet
        return Saving(self.progress.packets, target, notes, most)

    def save(self, wanted: Saving) -> str:
        """Save it; takes a while, so to be called in a thread of its own, unlike all else here.

        Returns:
            Why that was not possible, "" where it was.
        """
        process = self._start("saving")
        send(_pipe(process.stdin), wanted)
        out, _ = process.communicate()
        return out.decode() if process.returncode == 0 else self._last_words()

    def stop(self) -> None:
        """Wait for nothing more to come: what is there by now is read to its end, and stays."""
        with suppress(OSError):  # it has ended
            _pipe(self._reader.stdin).write(STOP)
            _pipe(self._reader.stdin).flush()

    def doubt(self, why: str) -> None:
        """Have told why nothing more may come, in one sentence; "" to take that back. From any thread."""
        self._pass(Doubt(why))

    def close(self) -> None:
        """End all processes and remove the journal."""
        self.is_closed = True
        self._tell = lambda message: None
        for process in (self._reader, self._searcher):
            if process is not None:
                _end(process)
        if self.journal is not None:
            self.journal.close()
        if self.calls is not None:
            self.calls.close()
        for thread in self._threads:
            thread.join(_GRACE)
        self._errors.close()
        self._folder.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    _let_go(process)
    process.terminate()
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _let_go(process: subprocess.Popen[bytes]) -> None:
    """Tell a process that nothing more is wanted."""
    with suppress(OSError):  # it ended before it had read all
        _pipe(process.stdin).close()


def _pipe(stream: IO[bytes] | None) -> Any:
    """Return a pipe of a process that was started with one."""
    assert stream is not None
    return stream
