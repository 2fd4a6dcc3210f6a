"""``bcapscope calls``: requests with their retries and replies, and what became of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from itertools import chain, starmap

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.call_reading import read_calls
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.protocol.text_format import counted
from bcapscope.render.call_record import CallRecordRenderer
from bcapscope.render.call_text import CallRenderer, session_text
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.handle_tracker import HandleTracker, TrackedObject

_MAX_SESSIONS_LISTED = 8


@click.command(short_help="Pair requests, retries and replies: a line a call.")
@options.paths
@options.interface
@options.ports
@click.option("--tree", is_flag=True, help="Each call's frames under it, with the times between.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a call.")
@options.filter_option(RecordKind.CALL)
@options.time_format
@options.color
def command(
    *,
    paths: tuple[str, ...],
    interface: str | None,
    ports: tuple[int, ...],
    tree: bool,
    as_json: bool,
    wanted: Filter | None,
    clock: str,
    color: str,
) -> None:
    """Pair the frames of captures to calls.

    A line has: number, start, client > server, function and command, result, time to the accepted reply,
    retries and what they came from as far as the capture can tell, frame numbers of requests > replies.
    Calls come when they settle; the number tells the order in which they started.

    Exit codes: as of decode.
    """
    if tree and as_json:
        raise click.UsageError("--tree and --json exclude each other")
    reading = CaptureReader(paths, ports, interface)
    calls = _FilteredCalls(read_calls(reading), wanted)
    if as_json:
        lines: Iterable[str] | Iterable[bytes] = starmap(CallRecordRenderer().record, calls.calls())
    else:
        renderer = CallRenderer(TimeFormat(clock), choose_palette(color))
        reading.on_first_time = renderer.set_time_origin
        lines = starmap(renderer.line, calls.all_items())
        if tree:
            lines = chain.from_iterable(starmap(renderer.tree, calls.all_items()))
    reading.output.write_lines(lines, reading.show_progress)
    reading.print_summary()
    calls.print_summary()
    sys.exit(reading.exit_code)


class _FilteredCalls:
    """What settled, with the objects that handles stand for, and what is to be said at the end."""

    def __init__(self, settled: Iterable[PairingResult], wanted: Filter | None) -> None:
        self._settled = settled
        self._test = None if wanted is None else wanted.bind(CALL_GETTERS)
        self._handles = HandleTracker()
        self._stray_count = 0
        self._first_stray = 0

    def all_items(self) -> Iterator[tuple[PairingResult, TrackedObject | None]]:
        """Yield the calls that are wanted, and what belongs to no call unless something else is wanted."""
        wanted = self._test
        for item in self._settled:
            if isinstance(item, Call):
                subject = self._handles.on_call(item)
                if wanted is None or wanted(item):
                    yield item, subject
            else:
                self._stray_count += 1
                self._first_stray = self._first_stray or item.observation.number
                if wanted is None:
                    yield item, None

    def calls(self) -> Iterator[tuple[Call, TrackedObject | None]]:
        """Yield the calls that are wanted; for what belongs to none, JSON has no place."""
        for item, subject in self.all_items():
            if isinstance(item, Call):
                yield item, subject

    def print_summary(self) -> None:
        """Tell on stderr what belongs to no call, and which sessions left something behind."""
        if self._stray_count:
            count = counted(self._stray_count, "reply", "replies")
            print_stderr(f"{count} to no open call, the first in frame {self._first_stray}")
        unclean = [session for session in self._handles.sessions() if not session.is_clean]
        for session in unclean[:_MAX_SESSIONS_LISTED]:
            print_stderr(session_text(session))
        if len(unclean) > _MAX_SESSIONS_LISTED:
            print_stderr(
                f"… and {len(unclean) - _MAX_SESSIONS_LISTED} more sessions that were not ended in order"
            )
