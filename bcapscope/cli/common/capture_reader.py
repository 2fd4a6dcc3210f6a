"""Read captures for a command, and print a summary of the traffic and of read errors."""

from __future__ import annotations

import io
import select
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NoReturn, cast

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
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count
from bcapscope.render.capture_counts_text import capture_counts_text
from bcapscope.render.escape import printable
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.observation import Observation

if TYPE_CHECKING:
    from bcapscope.capture.place_decoder import PlaceDecoder
    from bcapscope.capture.place_plan import PlacePlan
    from bcapscope.traffic.handle_tracker import HandleTracker
    from bcapscope.traffic.joining.joiner import Joiner
    from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber

STDIN = "-"
_MAX_SERVERS_LISTED = 8


class CaptureReader:
    """Reads the input of a command. Several captures are read as one, like the files of a ring.

    `on_first_time` is called with the time of the first observation, before that observation is yielded.
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
    ) -> None:
        """Choose the input: captures, a live interface, or pasted hex text. The path ``-`` is standard input.

        `side` selects one side of the conversations that were captured at two places; None for both.

        Raises:
            click.UsageError: there is no input, or more than one kind, or standard input is closed.
        """
        if bool(paths) + bool(interface) + bool(text) != 1:
            raise click.UsageError("give captures, - for standard input, or an interface with -i")
        if STDIN in (*paths, text) and sys.stdin is None:
            raise click.UsageError("standard input is closed")
        self.exit_code = ExitCode.OK
        self.on_first_time: Callable[[int], object] = lambda time: None
        self.output = DataOutput(1) if interface or STDIN in (*paths, text) else DataOutput()
        self._paths = paths
        self._interface = interface
        self._text = text
        self._words = words
        self._side = side
        self._joiner: Joiner | None = None
        self._pasted = None if text is None else PastedText(self._text_lines(text))
        known_ports = frozenset(ports) or BCAP_PORTS
        self._plans: list[PlacePlan] = []
        self._places: PlaceDecoder | None = None
        if len(paths) > 1 and STDIN not in paths:
            self._plan_places(known_ports)
        self._observer = self._places or PacketDecoder(known_ports)
        self._progress = ReadProgressBar()
        self._file: CaptureFile | None = None
        self._lost_packets = 0
        self._problems: list[str] = []

    def observations(self) -> Iterator[Observation]:
        """Yield all frames of the input, or those of one side.

        Read errors do not raise an exception; `print_summary` prints them.
        """
        observations = self._all_observations()
        return observations if self._side is None else self._of_side(observations, self._side)

    @staticmethod
    def _of_side(observations: Iterator[Observation], side: CapturePlace) -> Iterator[Observation]:
        from bcapscope.traffic.joining.joiner import Joiner

        joiner = Joiner(only=side)
        for observation in observations:
            yield from joiner.add(observation)
        yield from joiner.close()

    def _all_observations(self) -> Iterator[Observation]:
        if self._pasted is not None:
            yield from self._pasted
            return
        observations = self._decode()
        for first in observations:
            self.on_first_time(first.time)
            yield first
            break
        yield from observations
        self._progress.remove()

    def pipeline(self, *subscribers: PipelineSubscriber, handles: HandleTracker | None = None) -> Pipeline:
        """Return a pipeline for the input, which joins the conversations that several places captured."""
        from bcapscope.traffic.joining.joiner import Joiner
        from bcapscope.traffic.pipeline import Pipeline

        self._joiner = Joiner(self.comments) if self._side is None else None
        return Pipeline(*subscribers, handles=handles, joiner=self._joiner)

    def _decode(self) -> Iterator[Observation]:
        if self._places is not None:
            return self._places.observations()
        packets = self._live_packets() if self._interface else self._file_packets(self._paths)
        return self._observer.decode(packets)

    @property
    def ended_at(self) -> int:
        """Time of the last packet of any protocol, in ns since 1970.

        This property is valid after all observations were read.
        """
        return self._observer.end_time

    @property
    def comments(self) -> Mapping[int, tuple[str, ...]]:
        return self._observer.comments if self._pasted is None else self._pasted.comments

    def show_progress(self) -> None:
        """Show the progress of reading a file that takes long."""
        if self._file is not None:
            self._progress.show(self._file.position, self._file.size)

    def print_lines(self, lines: Iterable[str] | Iterable[bytes]) -> None:
        """Print lines of data, and show the progress of reading after each batch of lines."""
        self.output.write_lines(lines, self.show_progress)

    def finish(self) -> NoReturn:
        """Print the summary and exit."""
        self.print_summary()
        sys.exit(self.exit_code)

    def print_summary(self) -> None:
        """Print to stderr read errors, the controllers that were recognised by content, and packet counts."""
        if self._pasted is not None:
            self._print_text_summary(self._pasted.count)
            return
        self._progress.remove()
        words = self._words
        for trouble in self._problems:
            print_stderr(trouble)
        if self._plans:
            self._print_plans()
        recognised = [c for c in self._observer.conversations if not c.server_known_by.startswith("port ")]
        for conversation in recognised[:_MAX_SERVERS_LISTED]:
            server, transport = str(conversation.server), str(conversation.transport)
            reason = conversation.server_known_by
            print_stderr(words("reading.recognised", server=server, transport=transport, reason=reason))
        if len(recognised) > _MAX_SERVERS_LISTED:
            print_stderr(words("reading.recognised.more", n=len(recognised) - _MAX_SERVERS_LISTED))
        if self._lost_packets:
            print_stderr(words("reading.lost", packets=Count(self._lost_packets, "packet")))
        if self._joiner is not None and self._joiner.own_requests:
            own = Count(self._joiner.own_requests, "request")
            print_stderr(words("reading.own-requests", requests=own))
        counts = self._observer.counts
        if counts.packets or self.exit_code is not ExitCode.UNREADABLE:
            print_stderr(capture_counts_text(counts, words))

    def _plan_places(self, ports: frozenset[int]) -> None:
        """Find out which captures hold the same conversation, and prepare to decode these together."""
        from bcapscope.capture.place_decoder import PlaceDecoder
        from bcapscope.capture.place_plan import plan_places

        self._plans = plan_places(self._paths, ports)
        if self._plans:
            self._places = PlaceDecoder(self._paths, self._plans, ports, self._file_packets)

    def _print_plans(self) -> None:
        from bcapscope.render.place_text import place_plan_text

        for plan in self._plans:
            print_stderr(self._words.text(place_plan_text(plan)))

    def _text_lines(self, path: str) -> Iterator[str]:
        """Yield the lines of a text file, and keep a read error for `print_summary`."""
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
        for trouble in self._problems:
            print_stderr(trouble)
        if packets:
            print_stderr(self._words("reading.text", packets=Count(packets, "packet")))
            return
        if self.exit_code is ExitCode.OK:
            print_stderr(self._words("reading.no-hex", input=self._input_name(self._text or "")))
        self.exit_code = ExitCode.UNREADABLE

    def _live_packets(self) -> Iterator[Packet]:
        name = self._interface or ""
        try:
            with open_live_capture(name) as capture, DeferredInterrupts() as interrupts:
                print_stderr(self._words("reading.live", interface=printable(name)))
                packets = iter(capture)
                try:
                    while (packet := interrupts.read_or_stop(partial(next, packets, None))) is not None:
                        yield packet
                    print_stderr("")
                finally:
                    self._lost_packets = capture.lost
        except CaptureError as error:
            print_stderr(f"{printable(name)}: {self._words.text(error.message)}")
            self.exit_code = ExitCode.UNREADABLE

    def _file_packets(self, paths: Sequence[str]) -> Iterator[Packet]:
        for path in paths:
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
        self._problems.append(f"{self._input_name(path)}: {self._words.text(error.message)}")
        self.exit_code = max(self.exit_code, ExitCode.DAMAGED if error.offset else ExitCode.UNREADABLE)

    def _input_name(self, path: str) -> str:
        return self._words("reading.stdin") if path == STDIN else printable(path)


class _Interrupted(Exception):
    """Ctrl-C ended reading, possibly inside a packet.

    The capture does not count as incomplete for this reason.
    """


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
        """Stop handling Ctrl-C. Standard input is not closed, because it belongs to the interpreter."""
        self._interrupts.close()
