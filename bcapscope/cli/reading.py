"""Reading captures for a command: where packets come from, and what the user is told about them."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import BinaryIO, cast

import click

from bcapscope.capture.counts import Counts
from bcapscope.capture.file import CaptureFile, open_capture
from bcapscope.capture.observer import Observer
from bcapscope.capture.packet import Packet
from bcapscope.capture.sides import PORTS
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import Output, narrate
from bcapscope.cli.progress import Progress
from bcapscope.errors import CaptureError
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation

STDIN = "-"
_MOST_SIDES_TOLD = 8


class Reading:
    """One command's traffic: captures read one after the other, as the files of a ring are.

    Attributes:
        exit: how reading went so far.
    """

    def __init__(self, paths: Sequence[str], ports: Collection[int], output: Output) -> None:
        """Read `paths`, ``-`` being standard input, for servers on `ports`, or on 5007 if there are none."""
        if not paths:
            raise click.UsageError("name a capture, or - for standard input")
        self.exit = Exit.OK
        self._paths = paths
        self._observer = Observer(frozenset(ports) or PORTS)
        self._output = output
        self._progress = Progress()
        self._file: CaptureFile | None = None

    def observations(self) -> Iterator[Observation]:
        """Yield all that is said; what cannot be read is told on stderr, in one sentence each."""
        yield from self._observer.observe(self._packets())
        self._progress.done()

    def pause(self) -> None:
        """Show how far reading has come, if it takes long."""
        if self._file is not None:
            self._progress.show(self._file.position, self._file.size)

    def summary(self) -> None:
        """Tell on stderr what was read, what was left aside, and which servers had to be worked out."""
        told = [c for c in self._observer.conversations if not c.side_known_by.startswith("port ")]
        for conversation in told[:_MOST_SIDES_TOLD]:
            server, reason = conversation.server, conversation.side_known_by
            narrate(f"server {server} ({conversation.transport}), told by {reason}")
        if len(told) > _MOST_SIDES_TOLD:
            narrate(f"… and {len(told) - _MOST_SIDES_TOLD} more servers told by what was said")
        narrate(_counted(self._observer.counts))

    def _packets(self) -> Iterator[Packet]:
        for path in self._paths:
            try:
                with self._open(path) as self._file:
                    yield from self._file
            except CaptureError as error:
                self._report(path, error)

    def _open(self, path: str) -> CaptureFile:
        if path != STDIN:
            return open_capture(path)
        return CaptureFile(cast(BinaryIO, _Patient(sys.stdin.buffer, self._output)))

    def _report(self, path: str, error: CaptureError) -> None:
        self._output.flush()
        self._progress.done()
        narrate(f"{'standard input' if path == STDIN else printable(path)}: {error}")
        self.exit = max(self.exit, Exit.DAMAGED if error.offset else Exit.UNREADABLE)


class _Patient:
    """Standard input that lets everything found so far be written out before it waits for more."""

    def __init__(self, stream: BinaryIO, output: Output) -> None:
        self._stream = stream
        self._output = output

    def read1(self, size: int) -> bytes:
        self._output.flush()
        return cast(bytes, self._stream.read1(size))  # type: ignore[attr-defined]  # a BufferedReader has it

    def fileno(self) -> int:
        return self._stream.fileno()

    def close(self) -> None:
        """Leave standard input to the interpreter."""


def _counted(counts: Counts) -> str:
    return f"{_number(counts.frames, 'frame')} in {_number(counts.packets, 'packet')}" + "".join(
        f"; {text}" for text in _oddities(counts)
    )


def _oddities(counts: Counts) -> Iterable[str]:
    if counts.malformed:
        yield f"{counts.malformed} malformed"
    if counts.gaps:
        yield f"{_number(counts.gaps, 'gap')} of {_number(counts.missing, 'byte')} in all"
    if counts.not_bcap + counts.not_ip:
        yield f"{_number(counts.not_bcap + counts.not_ip, 'packet')} of other protocols"
    if counts.cut:
        yield f"{_number(counts.cut, 'packet')} cut short by the capture"
    if counts.broken:
        yield f"{_number(counts.broken, 'packet')} with damaged headers"
    if counts.fragments_lost:
        yield f"{_number(counts.fragments_lost, 'datagram')} with missing fragments"
    if counts.contradictions:
        yield f"{_number(counts.contradictions, 'TCP segment')} sent again with other bytes"
    for link, count in sorted(counts.unknown_links.items()):
        yield f"{_number(count, 'packet')} of link type {link}, which is not known here"


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
