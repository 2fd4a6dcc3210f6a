"""Reading captures for a command: where packets come from, and what the user is told about them."""

from __future__ import annotations

import io
import select
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import BinaryIO, cast

import click

from bcapscope.capture.file import CaptureFile, open_capture
from bcapscope.capture.live import open_live
from bcapscope.capture.observer import Observer
from bcapscope.capture.packet import Packet
from bcapscope.capture.pasted import Pasted
from bcapscope.capture.sides import PORTS
from bcapscope.capture.textlines import text_lines
from bcapscope.cli.exits import Exit
from bcapscope.cli.interrupts import Interrupts
from bcapscope.cli.output import Output, narrate
from bcapscope.cli.progress import Progress
from bcapscope.errors import CaptureError
from bcapscope.protocol.wording import counted
from bcapscope.render.counts import counts_text
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation

STDIN = "-"
_MOST_SIDES_TOLD = 8


class Reading:
    """One command's traffic: captures read one after the other, as the files of a ring are.

    Attributes:
        exit: how reading went so far.
        output: where the command writes its data.
        begin: is told the time of the first observation before it is given out.
    """

    def __init__(
        self,
        paths: Sequence[str],
        ports: Collection[int],
        interface: str | None = None,
        text: str | None = None,
    ) -> None:
        """Choose what to read.

        Args:
            paths: captures, ``-`` being standard input.
            ports: where servers listen; 5007 if there are none.
            interface: capture live on it, instead of reading.
            text: a file with pasted hex, ``-`` being standard input, instead of either.

        Raises:
            click.UsageError: there is nothing to read, or more than one thing.
        """
        if bool(paths) + bool(interface) + bool(text) != 1:
            raise click.UsageError("name a capture, - for standard input, or an interface with -i")
        if STDIN in (*paths, text) and sys.stdin is None:
            raise click.UsageError("standard input is closed")
        self.exit = Exit.OK
        self.begin: Callable[[int], object] = lambda time: None
        self.output = Output(1) if interface or STDIN in (*paths, text) else Output()
        self._paths = paths
        self._interface = interface
        self._text = text
        self._pasted = None if text is None else Pasted(self._lines(text))
        self._observer = Observer(frozenset(ports) or PORTS)
        self._progress = Progress()
        self._file: CaptureFile | None = None
        self._lost = 0
        self._troubles: list[str] = []

    def observations(self) -> Iterator[Observation]:
        """Yield all that is said; what cannot be read is told on stderr, in one sentence each."""
        if self._pasted is not None:
            yield from self._pasted
            return
        observations = self._observer.observe(self._live() if self._interface else self._packets())
        for first in observations:
            self.begin(first.time)
            yield first
            break
        yield from observations
        self._progress.done()

    @property
    def ended(self) -> int:
        """When the latest packet was captured, whatever was in it, nanoseconds since 1970; 0 for pasted text.

        Known once all observations were taken.
        """
        return self._observer.ended

    @property
    def comments(self) -> Mapping[int, tuple[str, ...]]:
        """Comments of the packets read lately, by the number of the packet."""
        return self._observer.comments if self._pasted is None else self._pasted.comments

    def pause(self) -> None:
        """Show how far reading has come, if it takes long."""
        if self._file is not None:
            self._progress.show(self._file.position, self._file.size)

    def summary(self) -> None:
        """Tell on stderr what was read, what could not be, and which servers had to be worked out."""
        if self._pasted is not None:
            self._summarize_text(self._pasted.count)
            return
        self._progress.done()
        for trouble in self._troubles:
            narrate(trouble)
        told = [c for c in self._observer.conversations if not c.side_known_by.startswith("port ")]
        for conversation in told[:_MOST_SIDES_TOLD]:
            server, reason = conversation.server, conversation.side_known_by
            narrate(f"server {server} ({conversation.transport}), told by {reason}")
        if len(told) > _MOST_SIDES_TOLD:
            narrate(f"… and {len(told) - _MOST_SIDES_TOLD} more servers told by what was said")
        if self._lost:
            narrate(f"{counted(self._lost, 'packet')} lost: there was no room for more")
        counts = self._observer.counts
        if counts.packets or self.exit is not Exit.UNREADABLE:
            narrate(counts_text(counts))

    def _lines(self, path: str) -> Iterator[str]:
        """Yield the lines of a text; what cannot be read is reported."""
        try:
            with closing(_StandardInput()) if path == STDIN else Path(path).open("rb", buffering=0) as stream:
                yield from text_lines(stream.read)
        except _Interrupted:
            return
        except OSError as error:
            self._report(path, CaptureError(f"cannot be opened: {error.strerror}"))
        except CaptureError as error:
            self._report(path, error)

    def _summarize_text(self, packets: int) -> None:
        for trouble in self._troubles:
            narrate(trouble)
        if packets:
            narrate(f"{counted(packets, 'packet')} found in the text")
            return
        if self.exit is Exit.OK:
            name = "standard input" if self._text == STDIN else printable(self._text or "")
            narrate(f"{name}: there is no hex in this text")
        self.exit = Exit.UNREADABLE

    def _live(self) -> Iterator[Packet]:
        name = self._interface or ""
        try:
            with open_live(name) as capture, Interrupts() as interrupts:
                narrate(f"capturing on {printable(name)}, Ctrl-C ends")
                packets = iter(capture)
                try:
                    while (packet := interrupts.wait(partial(next, packets), None)) is not None:
                        yield packet
                    narrate("")
                finally:
                    self._lost = capture.lost
        except CaptureError as error:
            narrate(f"{printable(name)}: {error}")
            self.exit = Exit.UNREADABLE

    def _packets(self) -> Iterator[Packet]:
        for path in self._paths:
            try:
                with self._open(path) as self._file:
                    yield from self._file
            except _Interrupted:
                return
            except CaptureError as error:
                self._report(path, error)

    def _open(self, path: str) -> CaptureFile:
        if path != STDIN:
            return open_capture(path)
        return CaptureFile(cast(BinaryIO, _StandardInput()))

    def _report(self, path: str, error: CaptureError) -> None:
        self._troubles.append(f"{'standard input' if path == STDIN else printable(path)}: {error}")
        self.exit = max(self.exit, Exit.DAMAGED if error.offset else Exit.UNREADABLE)


class _Interrupted(Exception):
    """Ctrl-C: no more is read, be it in the middle of a packet; that is not where the capture breaks off."""


class _StandardInput:
    """Gives what there is without waiting for more."""

    def __init__(self) -> None:
        self._stream = io.FileIO(sys.stdin.fileno(), closefd=False)
        self._interrupts = Interrupts()

    def read(self, size: int) -> bytes:
        found = self._interrupts.wait(partial(self._next, size), None)
        if found is None:
            raise _Interrupted
        return found

    def _next(self, size: int) -> bytes:
        while (found := self._stream.read(size)) is None:  # somebody made the pipe non-blocking
            select.select([self._stream], [], [])
        return found

    def fileno(self) -> int:
        return self._stream.fileno()

    def close(self) -> None:
        """Leave standard input to the interpreter."""
        self._interrupts.close()
