"""The process that reads: packets go into a journal, calls beside it, and the screen is told what to think.

Run as ``python -m bcapscope.tui.traffic.reading``; the job comes through standard input, reports go to
standard output. What follows the job on standard input says that nothing more will be written to the capture;
when it is closed, by the screen or by its death, reading ends at once.
"""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from bcapscope.capture.callbook import CallbookWriter
from bcapscope.capture.file import CaptureFile, open_capture
from bcapscope.capture.following import follow_capture
from bcapscope.capture.journal import JournalWriter
from bcapscope.capture.live import open_live
from bcapscope.capture.observer import Observer
from bcapscope.capture.packet import Packet
from bcapscope.capture.packetfile import PacketWriter
from bcapscope.capture.sides import PORTS
from bcapscope.errors import CaptureError
from bcapscope.render.counts import counts_text
from bcapscope.render.escape import printable
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.handles import Handles
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.question import Questions
from bcapscope.traffic.tracker import Tracker
from bcapscope.tui.traffic.report import Job, Progress, receive, send, step_back

if TYPE_CHECKING:
    from bcapscope.tui.traffic.judge import Judge

FLUSH = 0.1
"""Seconds between two moments at which the screen is told of new frames: what it draws then delays keys."""

JUDGE = 1.5
"""Seconds between two moments at which it is told what to think of them."""

_BATCH = 0xFF
"""Frames between two looks at the clock, less 1: a fraction of a millisecond."""

LIVE_FILE = "live.pcapng"


class Reading:
    """One job."""

    def __init__(
        self, job: Job, reports: BinaryIO, ended: threading.Event, unwanted: threading.Event
    ) -> None:
        """Begin.

        Args:
            job: what to read.
            reports: where reports go.
            ended: is set when what is there by then is all there will be.
            unwanted: is set when nothing more is to be read, be it there or not.
        """
        self._job = job
        self._reports = reports
        self._ended, self._unwanted = ended, unwanted
        folder = Path(job.folder)
        self._journal = JournalWriter(folder)
        self._calls = CallbookWriter(folder)
        self._observer = Observer(frozenset(job.ports) or PORTS, job.leg)
        self._tracker = Tracker()
        self._handles = Handles()
        self._judge: Judge | None = None
        self._unjudged: list[Observation] = []
        self._file: CaptureFile | None = None
        self._live = _Live(job.interface, folder / LIVE_FILE) if job.interface else None
        self._packets = str(folder / LIVE_FILE) if job.interface else job.path
        self._flushed = self._judged = time.monotonic()
        self._judged_at = 0
        self._latest = self._since = 0

    def run(self) -> None:
        """Read to the end, or until nothing more is wanted."""
        with closing(self._journal), closing(self._calls):
            trouble = ""
            try:
                self._read()
            except CaptureError as error:
                trouble = printable(str(error))
            except OSError as error:
                trouble = printable(f"{error.strerror or error}")
            judge, tracker, end = self._the_judge(), self._tracker, self._observer.ended
            for settled in (*tracker.expire(end), *tracker.close()):
                self._settle(settled)
            self._flush()
            send(self._reports, judge.verdict(end, self._job.own))
            send(self._reports, self._progress(True, trouble))

    def _read(self) -> None:
        about, comments = Questions().about, self._observer.comments
        add, take = self._journal.add, self._wait
        for seen in self._observer.observe(self._source()):
            add(seen, about(seen), comments.get(seen.packet, ()) if comments else ())
            take(seen)
            if not seen.number & _BATCH:
                if self._judge is None:
                    self._flush()
                    send(self._reports, self._progress(False))
                    self._the_judge()
                    take = self._take
                self._pause()
                if self._unwanted.is_set():
                    return

    def _wait(self, seen: Observation) -> None:
        """Keep what is seen before there is a judge: loading all the rules would keep the screen empty."""
        if self._judge is None:
            self._unjudged.append(seen)
        else:
            self._take(seen)

    def _the_judge(self) -> Judge:
        if self._judge is None:
            from bcapscope.tui.traffic.judge import Judge  # noqa: PLC0415 - see _wait
            from bcapscope.tui.words import Language, tongue  # noqa: PLC0415 - likewise

            self._judge = Judge(tongue(Language(self._job.language)))
            for seen in self._unjudged:
                self._take(seen)
            self._unjudged.clear()
        return self._judge

    def _take(self, seen: Observation) -> None:
        judge = self._the_judge()
        judge.look(seen)
        for settled in self._tracker.observe(seen):
            self._settle(settled)

    def _settle(self, settled: Settled) -> None:
        judge = self._the_judge()
        subject = self._handles.follow(settled) if isinstance(settled, Exchange) else None
        self._calls.add(settled, subject)
        judge.take(settled)

    def _source(self) -> Iterator[Packet]:
        if self._live is not None:
            self._live.start(self._ended)
            path, follow = self._live.path, True
        else:
            path, follow = Path(self._job.path), self._job.follow
        with follow_capture(path, self._ended, self._idle) if follow else open_capture(path) as self._file:
            yield from self._file
        if self._live is not None and self._live.trouble is not None:
            raise self._live.trouble

    def _idle(self) -> None:
        """Let calls settle as time passes; called while nothing new is seen."""
        if self._live is not None and self._live.trouble is not None:
            self._ended.set()
        if self._journal.count:
            self._the_judge()
        for settled in self._tracker.expire(self._now()):
            self._settle(settled)
        self._pause()

    def _now(self) -> int:
        """Tell the time by the clock that the packets have: another machine's maybe, or that of long ago."""
        latest, now = self._observer.ended, time.monotonic_ns()
        if latest != self._latest:
            self._latest, self._since = latest, now
        return latest + now - self._since

    def _pause(self) -> None:
        now = time.monotonic()
        if now - self._flushed < FLUSH:
            return
        self._flush()
        send(self._reports, self._progress(False))
        self._flushed = now
        seen = self._journal.count + self._calls.count
        if now - self._judged >= JUDGE and seen != self._judged_at:
            send(self._reports, self._the_judge().verdict(self._observer.ended, self._job.own))
            self._judged, self._judged_at = time.monotonic(), seen

    def _flush(self) -> None:
        self._journal.flush()
        self._calls.flush()

    def _progress(self, ended: bool, trouble: str = "") -> Progress:
        file = self._file
        return Progress(
            position=file.position if file is not None else 0,
            size=(file.size or 0) if file is not None else 0,
            ended=ended,
            trouble=trouble,
            summary=counts_text(self._observer.counts) if ended else "",
            clients=len(self._observer.conversations),
            packets=self._packets,
            lost=self._live.lost if self._live is not None else 0,
        )


class _Live:
    """Captures on an interface in a thread of its own and writes all packets to a file.

    Attributes:
        path: of the file.
        trouble: why capturing ended; None while it goes on.
        lost: packets for which there was no room.
    """

    def __init__(self, interface: str, path: Path) -> None:
        self.path = path
        self.trouble: CaptureError | None = None
        self.lost = 0
        self._interface = interface
        # What is not buffered is in the file at once, so that a kill loses nothing.
        self._writer = PacketWriter(path.open("xb", buffering=0))

    def start(self, ended: threading.Event) -> None:
        """Begin."""
        threading.Thread(target=self._run, args=(ended,), daemon=True, name="capture").start()

    def _run(self, ended: threading.Event) -> None:
        try:
            with open_live(self._interface) as capture:
                for packet in capture:
                    self._writer.write(packet)
                    self.lost = capture.lost
                    if ended.is_set():
                        return
        except CaptureError as error:
            self.trouble = error
        except OSError as error:
            self.trouble = CaptureError(f"the packets cannot be kept: {error.strerror}")


def main() -> None:
    """Read as standard input says."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is a key of the screen
    step_back()
    asked = io.FileIO(0, closefd=False)  # not sys.stdin, whose lock a thread would hold at the end
    job = next(receive(asked, Job), None)
    if job is None:
        return
    ended, unwanted = threading.Event(), threading.Event()

    def wait_for_the_end() -> None:
        while asked.read(1):
            ended.set()
        unwanted.set()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True, name="end").start()
    gc.freeze()
    gc.set_threshold(20_000, 20, 100)  # frames and calls hold no cycles
    try:
        Reading(job, cast(BinaryIO, sys.stdout.buffer), ended, unwanted).run()
    except BrokenPipeError:  # the screen is gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
