"""Read captures for a command, and print a summary of the traffic and of the errors."""

from __future__ import annotations

import io
import os
import select
import stat
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NoReturn, TextIO, TypeVar, cast

import click

from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.capture_input import CaptureInput
from bcapscope.capture.capture_sequence import STDIN, CaptureSequence
from bcapscope.capture.live_capture import open_live_capture
from bcapscope.capture.packet import Packet
from bcapscope.capture.pasted_text import PastedText, text_lines
from bcapscope.cli.common.data_output import LINES_AT_ONCE, write_lines
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.progress_bar import ReadProgressBar
from bcapscope.errors import CaptureError
from bcapscope.live.deferred_interrupts import DeferredInterrupts
from bcapscope.live.standard_streams import print_stderr
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count, joined_clauses
from bcapscope.render.capture_text import capture_counts_text, places_message, server_evidence_message
from bcapscope.render.escape import printable
from bcapscope.traffic.call import Call
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.observation import Observation, ServerEvidenceKind

if TYPE_CHECKING:
    from bcapscope.traffic.pipeline import PipelineSubscriber

R = TypeVar("R")

_PROGRESS_EVERY = 0x1000
"""Number of frames between updates of the progress bar; a power of two."""

_MAX_SERVERS_LISTED = 8
_IDLE_INTERVAL = 250_000_000  # ns


class CaptureReader(CaptureInput):
    """The input of a command. Several captures, such as the files of a ring, are read as one.

    Attributes:
        on_idle: Called several times per second during a live capture, with the time up to which all packets
            were read, ns since 1970.
        is_live: Whether the input may never end: an interface or a pipe.
    """

    def __init__(
        self,
        paths: Sequence[str],
        ports: Collection[int],
        interface: str | None = None,
        text: str | None = None,
        words: MessageFormatter = ENGLISH_WORDS,
        *,
        side: CapturePlace | None = None,
        taken_at: CapturePoint | None = None,
        comment_words: MessageFormatter = ENGLISH_WORDS,
    ) -> None:
        """Choose the input: captures, a live interface, or pasted hex text. The path ``-`` is standard input.

        `comment_words` formats the comments on pasted frames. Raises click.UsageError unless exactly one kind
        of input is given.
        """
        if bool(paths) + bool(interface) + bool(text) != 1:
            raise click.UsageError("give captures or '-' (standard input), or give an interface with -i")
        reads_stdin = STDIN in (*paths, text)
        if reads_stdin and sys.stdin is None:
            raise click.UsageError("standard input is closed")
        self.exit_code = ExitCode.OK
        self.on_idle: Callable[[int], object] = lambda time: None
        self.is_live = bool(interface) or (reads_stdin and not _is_file(sys.stdin))
        self._lines_at_once = 1 if interface or reads_stdin else LINES_AT_ONCE
        self._interface = interface
        self._text = text
        self._words = words
        self._pasted = None if text is None else PastedText(self._text_lines(text), comment_words)
        self._progress = ReadProgressBar()
        self._filter: Filter | None = None
        self._tested_count, self._has_match = 0, False
        self._lost_packets = 0
        self._problems: list[str] = []
        super().__init__(paths, ports, self._add_problem, side=side, taken_at=taken_at)

    def observations(self) -> Iterator[Observation]:
        """Yield all observations of the input. `print_summary` prints why reading a capture failed."""
        if self._pasted is not None:
            yield from self._pasted
            return
        yield from super().observations()
        self._progress.remove()

    def read_to_end(self, *subscribers: PipelineSubscriber) -> None:
        pipeline = self.pipeline(*subscribers)
        add = pipeline.add
        for count, observation in enumerate(self.observations()):
            add(observation)
            if not count & (_PROGRESS_EVERY - 1):
                self.show_progress()
        pipeline.finish(self.ended_at)

    def read_calls(self, wanted: Filter | None) -> Iterator[Call]:
        from bcapscope.traffic.pipeline import CallCollector

        collector = CallCollector(self.call_test(wanted))
        return self.read_items(self.pipeline(collector), collector.calls)

    def call_test(self, wanted: Filter | None) -> Callable[[Call], bool] | None:
        """Return a function that tests calls with the filter; None without a filter. See `record_test`."""
        return None if wanted is None else self.record_test(wanted, CALL_GETTERS, lambda call: call.number)

    def record_test(
        self, wanted: Filter, getters: Mapping[str, Callable[[R], object]], number_of: Callable[[R], int]
    ) -> Callable[[R], bool]:
        """Return a function that tests whether a record matches the filter `wanted`. `number_of` returns the
        number of a record. If no tested record matches, `print_summary` reports this.
        """
        self._filter = wanted
        test = wanted.bind(getters, lambda: self.first_time)

        def counted(record: R) -> bool:
            number, matches = number_of(record), test(record)
            self._tested_count = number if number > self._tested_count else self._tested_count
            self._has_match = self._has_match or matches
            return matches

        return counted

    def citing_words(self) -> MessageFormatter:
        """Return the formatter of messages. With several captures, messages name a frame's capture."""
        return self._words if len(self.captures.paths) < 2 else self._words.for_captures(self._find_frame)

    def _find_frame(self, frame: int) -> tuple[str, int] | None:
        found = self.find_frame(frame)
        return None if found is None else (printable(self._input_name(found[0])), found[1])

    @property
    def comments(self) -> Mapping[int, tuple[str, ...]]:
        return self.decoder.comments if self._pasted is None else self._pasted.comments

    def show_progress(self) -> None:
        self._progress.show(self.captures.position, self.captures.size)

    def print_lines(self, lines: Iterable[str] | Iterable[bytes]) -> None:
        write_lines(lines, self._lines_at_once, self.show_progress)

    def finish(self) -> NoReturn:
        self.print_summary()
        sys.exit(self.exit_code)

    def print_summary(self) -> None:
        if self._filter is not None and self._tested_count and not self._has_match:
            self._print_no_match(self._filter)
        self._progress.remove()
        for problem in self._problems:
            print_stderr(problem)
        if self._pasted is not None:
            self._print_text_summary(self._pasted.count)
            return
        words = self._words
        self._print_plans()
        recognised = [
            c for c in self.decoder.conversations if c.server_evidence.kind is not ServerEvidenceKind.PORT
        ]
        for conversation in recognised[:_MAX_SERVERS_LISTED]:
            server, transport = str(conversation.server), str(conversation.transport)
            reason = server_evidence_message(conversation)
            print_stderr(words("reading.recognised", server=server, transport=transport, reason=reason))
        if len(recognised) > _MAX_SERVERS_LISTED:
            print_stderr(words("reading.recognised.more", n=len(recognised) - _MAX_SERVERS_LISTED))
        if self._lost_packets:
            print_stderr(words("reading.lost", packets=Count(self._lost_packets, "packet")))
        if self.own_requests:
            print_stderr(words("reading.own-requests", requests=Count(self.own_requests, "request")))
        if self.decoder.counts.packets or self.exit_code is not ExitCode.UNREADABLE:
            print_stderr(capture_counts_text(self.decoder.counts, words))

    def _print_no_match(self, wanted: Filter) -> None:
        records = Count(self._tested_count, str(wanted.kind))
        unknown = joined_clauses(wanted.unknown_values)
        if unknown is None:
            print_stderr(self._words("filter.no-match", records=records))
        else:
            sentence = self._words("filter.no-match.because", records=records, unknown=unknown)
            print_stderr(printable(sentence))

    def _print_plans(self) -> None:
        for plan in self.plans:
            near, far = (printable(Path(file.path).name) for file in plan.files)
            print_stderr(self._words.text(places_message(near, far, plan.clock)))

    def _text_lines(self, path: str) -> Iterator[str]:
        try:
            with closing(_StandardInput()) if path == STDIN else Path(path).open("rb", buffering=0) as stream:
                yield from text_lines(stream.read)
        except _Interrupted:
            return
        except OSError as error:
            self._add_problem(path, CaptureError(Message("capture.cannot-open", reason=os_reason(error))))
        except CaptureError as error:
            self._add_problem(path, error)

    def _print_text_summary(self, packets: int) -> None:
        if packets:
            print_stderr(self._words("reading.text", packets=Count(packets, "packet")))
            return
        if self.exit_code is ExitCode.OK:
            print_stderr(self._words("reading.no-hex", input=self._input_name(self._text or "")))
        self.exit_code = ExitCode.UNREADABLE

    def _live_packets(self) -> Iterator[Packet]:
        name = self._interface or ""
        try:
            with open_live_capture(name) as capture, closing(DeferredInterrupts()) as interrupts:
                print_stderr(self._words("reading.live", interface=printable(name)))
                packets = iter(capture)
                capture.on_idle = lambda: interrupts.do_while_waiting(lambda: self.on_idle(time.time_ns()))
                idle_at = 0
                try:
                    while (packet := interrupts.read_or_stop(partial(next, packets, None))) is not None:
                        # while packets arrive constantly, the capture never calls `capture.on_idle`
                        if packet[0] >= idle_at:
                            self.on_idle(packet[0])
                            idle_at = packet[0] + _IDLE_INTERVAL
                        yield packet
                    print_stderr("")
                finally:
                    self._lost_packets = capture.lost
        except CaptureError as error:
            print_stderr(f"{printable(name)}: {self._words.text(error.message)}")
            self.exit_code = ExitCode.UNREADABLE

    def _packets(self, captures: CaptureSequence) -> Iterator[Packet]:
        if self._interface:
            yield from self._live_packets()
            return
        with suppress(_Interrupted):
            yield from captures

    def _open(self, path: str) -> CaptureFile:
        if path != STDIN:
            return super()._open(path)
        return CaptureFile(cast(BinaryIO, _StandardInput()))

    def _add_problem(self, path: str, error: CaptureError) -> None:
        self._problems.append(f"{self._input_name(path)}: {self._words.text(error.message)}")
        self.exit_code = max(self.exit_code, ExitCode.DAMAGED if error.offset else ExitCode.UNREADABLE)

    def _input_name(self, path: str) -> str:
        return self._words("reading.stdin") if path == STDIN else printable(path)


class _Interrupted(Exception):
    """Ctrl-C ended reading; an incomplete last packet is then not reported."""


def _is_file(stream: TextIO) -> bool:
    try:
        return stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except OSError:  # a test replaced standard input
        return False


class _StandardInput:
    def __init__(self) -> None:
        self._stream = io.FileIO(sys.stdin.fileno(), closefd=False)
        self._interrupts = DeferredInterrupts()

    def read(self, size: int) -> bytes:
        found = self._interrupts.read_or_stop(partial(self._next, size))
        if found is None:
            raise _Interrupted
        return found

    def _next(self, size: int) -> bytes:
        while (found := self._stream.read(size)) is None:  # another process made the pipe non-blocking
            select.select([self._stream], [], [])
        return found

    def fileno(self) -> int:
        return self._stream.fileno()

    def close(self) -> None:
        """Stop handling Ctrl-C. Standard input stays open, because it belongs to the interpreter."""
        self._interrupts.close()
