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

from bcapscope.capture.capture_file import CaptureFile, open_capture
from bcapscope.capture.live_capture import open_live_capture
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.capture.pasted_text import PastedText
from bcapscope.capture.role_detection import BCAP_PORTS
from bcapscope.capture.text_lines import text_lines
from bcapscope.cli.common.data_output import DataOutput
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.progress_bar import ReadProgressBar
from bcapscope.errors import CaptureError
from bcapscope.live.deferred_interrupts import DeferredInterrupts
from bcapscope.live.standard_streams import print_stderr
from bcapscope.protocol.text_format import counted
from bcapscope.render.capture_counts_text import capture_counts_text
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation

STDIN = "-"
_MAX_SERVERS_LISTED = 8


class CaptureReader:
    """One command's traffic: captures read one after the other, as the files of a ring are.

    Attributes:
        exit_code: how reading went so far.
        output: where the command writes its data.
        on_first_time: is told the time of the first observation before it is given out.
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
        self.exit_code = ExitCode.OK
        self.on_first_time: Callable[[int], object] = lambda time: None
        self.output = DataOutput(1) if interface or STDIN in (*paths, text) else DataOutput()
        self._paths = paths
        self._interface = interface
        self._text = text
        self._pasted = None if text is None else PastedText(self._text_lines(text))
        self._observer = PacketDecoder(frozenset(ports) or BCAP_PORTS)
        self._progress = ReadProgressBar()
        self._file: CaptureFile | None = None
        self._lost_packets = 0
        self._problems: list[str] = []

    def observations(self) -> Iterator[Observation]:
        """Yield all that is said; what cannot be read is told on stderr, in one sentence each."""
        if self._pasted is not None:
            yield from self._pasted
            return
        observations = self._observer.decode(
            self._live_packets() if self._interface else self._file_packets()
        )
        for first in observations:
            self.on_first_time(first.time)
            yield first
            break
        yield from observations
        self._progress.remove()

    @property
    def ended_at(self) -> int:
        """When the latest packet was captured, whatever was in it, nanoseconds since 1970; 0 for pasted text.

        Known once all observations were taken.
        """
        return self._observer.end_time

    @property
    def comments(self) -> Mapping[int, tuple[str, ...]]:
        """Comments of the packets read lately, by the number of the packet."""
        return self._observer.comments if self._pasted is None else self._pasted.comments

    def show_progress(self) -> None:
        """Show how far reading has come, if it takes long."""
        if self._file is not None:
            self._progress.show(self._file.position, self._file.size)

    def print_summary(self) -> None:
        """Tell on stderr what was read, what could not be, and which servers had to be worked out."""
        if self._pasted is not None:
            self._print_text_summary(self._pasted.count)
            return
        self._progress.remove()
        for trouble in self._problems:
            print_stderr(trouble)
        told = [c for c in self._observer.conversations if not c.server_known_by.startswith("port ")]
        for conversation in told[:_MAX_SERVERS_LISTED]:
            server, reason = conversation.server, conversation.server_known_by
            print_stderr(f"server {server} ({conversation.transport}), told by {reason}")
        if len(told) > _MAX_SERVERS_LISTED:
            print_stderr(f"… and {len(told) - _MAX_SERVERS_LISTED} more servers told by what was said")
        if self._lost_packets:
            print_stderr(f"{counted(self._lost_packets, 'packet')} lost: there was no room for more")
        counts = self._observer.counts
        if counts.packets or self.exit_code is not ExitCode.UNREADABLE:
            print_stderr(capture_counts_text(counts))

    def _text_lines(self, path: str) -> Iterator[str]:
        """Yield the lines of a text; what cannot be read is reported."""
        try:
            with closing(_StandardInput()) if path == STDIN else Path(path).open("rb", buffering=0) as stream:
                yield from text_lines(stream.read)
        except _Interrupted:
            return
        except OSError as error:
            self._add_problem(path, CaptureError(f"cannot be opened: {error.strerror}"))
        except CaptureError as error:
            self._add_problem(path, error)

    def _print_text_summary(self, packets: int) -> None:
        for trouble in self._problems:
            print_stderr(trouble)
        if packets:
            print_stderr(f"{counted(packets, 'packet')} found in the text")
            return
        if self.exit_code is ExitCode.OK:
            name = "standard input" if self._text == STDIN else printable(self._text or "")
            print_stderr(f"{name}: there is no hex in this text")
        self.exit_code = ExitCode.UNREADABLE

    def _live_packets(self) -> Iterator[Packet]:
        name = self._interface or ""
        try:
            with open_live_capture(name) as capture, DeferredInterrupts() as interrupts:
                print_stderr(f"capturing on {printable(name)}, Ctrl-C ends")
                packets = iter(capture)
                try:
                    while (packet := interrupts.read_or_stop(partial(next, packets), None)) is not None:
                        yield packet
                    print_stderr("")
                finally:
                    self._lost_packets = capture.lost
        except CaptureError as error:
            print_stderr(f"{printable(name)}: {error}")
            self.exit_code = ExitCode.UNREADABLE

    def _file_packets(self) -> Iterator[Packet]:
        for path in self._paths:
            try:
                with self._open(path) as self._file:
                    yield from self._file
            except _Interrupted:
                return
            except CaptureError as error:
                self._add_problem(path, error)

    def _open(self, path: str) -> CaptureFile:
        if path != STDIN:
            return open_capture(path)
        return CaptureFile(cast(BinaryIO, _StandardInput()))

    def _add_problem(self, path: str, error: CaptureError) -> None:
        self._problems.append(f"{'standard input' if path == STDIN else printable(path)}: {error}")
        self.exit_code = max(self.exit_code, ExitCode.DAMAGED if error.offset else ExitCode.UNREADABLE)


class _Interrupted(Exception):
    """Ctrl-C: no more is read, be it in the middle of a packet; that is not where the capture breaks off."""


class _StandardInput:
    """Gives what there is without waiting for more."""

    def __init__(self) -> None:
        self._stream = io.FileIO(sys.stdin.fileno(), closefd=False)
        self._interrupts = DeferredInterrupts()

    def read(self, size: int) -> bytes:
        found = self._interrupts.read_or_stop(partial(self._next, size), None)
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
