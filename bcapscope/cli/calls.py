"""``bcapscope calls``: show requests with their retries and replies, one line per call."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from itertools import chain, starmap
from typing import Any

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.column_options import column_renderer, columns_option, wide_option
from bcapscope.cli.common.data_output import folded_lines
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.messages import MessageFormatter
from bcapscope.messages.places import Count, FramePlace
from bcapscope.render.call_record import CallPackets, CallRecordRenderer
from bcapscope.render.call_text import CallRenderer, session_text
from bcapscope.render.display_filter import display_filter_lines, packets_of
from bcapscope.render.record_columns import CALL_COLUMNS, ColumnFormat, RecordColumn, parse_columns
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import Call, PairingResult, StrayReply
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.handle_tracker import HandleTracker, TrackedObject
from bcapscope.traffic.pipeline import PipelineSubscriber

_MAX_SESSIONS_LISTED = 8


@click.command()
@options.paths
@options.interface
@options.ports
@options.taken_at
@click.option(
    "--tree", is_flag=True, help="Show the frames of each call below its line, with the times between frames."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per call.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table with a header.")
@options.display_filter_option("call")
@columns_option(RecordKind.CALL)
@wide_option
@options.side
@options.filter_option(RecordKind.CALL)
@options.time_format
@options.color
@options.language
def command(
    *,
    interface: str | None,
    tree: bool,
    as_json: bool,
    as_csv: bool,
    display_filter: bool,
    columns: tuple[RecordColumn, ...] | None,
    wide: bool,
    wanted: Filter | None,
    clock: str,
    color: str,
    words: MessageFormatter,
    **source: Any,
) -> None:
    """Show the calls in captures: each request with its retries, notices and reply.

    Each line shows the number of a call, its start, client > controller, function, command, result and the
    time to the accepted reply. Each line ends with the number of retries, the cause of the retries if known,
    and the frame numbers. The sign > separates the frame numbers of requests from the frame numbers of
    replies. `calls` prints a call when the call is complete. The numbers of the calls show the order in which
    the calls started. On a terminal, long lines are folded.

    Exit codes: as for `decode`.
    """
    styles = [name for name, given in (("tree", tree), ("json", as_json), ("csv", as_csv)) if given]
    if len(styles) > 1:
        raise click.UsageError(f"{' and '.join(f'--{style}' for style in styles)} exclude each other")
    if columns is not None and tree:
        raise click.UsageError("--columns excludes --tree")
    if display_filter:
        _check_display_filter(as_json or as_csv or columns is not None, interface)
    if as_csv and columns is None:
        columns = parse_columns(",".join(CALL_COLUMNS), RecordKind.CALL)
    reading = CaptureReader(interface=interface, words=words, **source)
    calls = _ShownCalls(reading, wanted)
    if columns is not None:
        table = column_renderer(RecordKind.CALL, reading, columns, choose_palette(color), wide)
        format_ = ColumnFormat(styles[0]) if styles else None
        lines: Iterable[str] | Iterable[bytes] = table.lines((call for call, _ in calls.calls()), format_)
    elif as_json:
        record = CallRecordRenderer().record
        captures = reading.captures.paths
        packets = CallPackets(reading.captures.origin_of, captures[0] if len(captures) == 1 else None)
        lines = (packets.add_to(record(call, target), call) for call, target in calls.calls())
    else:
        renderer = CallRenderer(TimeFormat(clock), choose_palette(color), words=reading.citing_words())
        reading.on_first_time = renderer.set_time_origin
        lines = folded_lines(starmap(renderer.line, calls.all_items()), wide)
        if tree or display_filter:
            lines = chain.from_iterable(
                _call_lines(renderer, item, target, tree, calls.filter_lines(item) if display_filter else ())
                for item, target in calls.all_items()
            )
    reading.print_lines(lines)
    reading.print_summary()
    calls.print_summary(reading.citing_words())
    sys.exit(reading.exit_code)


def _check_display_filter(is_data: bool, interface: str | None) -> None:
    if is_data:
        raise click.UsageError("--display-filter cannot be combined with --json, --csv or --columns")
    if interface is not None:
        raise click.UsageError("--display-filter needs captures: leave out -i")


def _call_lines(
    renderer: CallRenderer,
    item: PairingResult,
    target: TrackedObject | None,
    tree: bool,
    filter_lines: Iterable[str],
) -> Iterator[str]:
    if tree:
        yield from renderer.tree(item, target)
    else:
        yield renderer.line(item, target)
    for line in filter_lines:
        yield f"       {line}"


class _ShownCalls(PipelineSubscriber):
    needs_targets = True

    def __init__(self, reader: CaptureReader, wanted: Filter | None) -> None:
        self._reader = reader
        self._test = reader.call_test(wanted)
        self._handles = HandleTracker()
        self._items: list[tuple[PairingResult, TrackedObject | None]] = []
        self._stray_count = 0
        self._first_stray = 0
        self._captured_again = 0

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        if call.other_frames:
            self._captured_again += len(call.captured_again)
        if self._test is None or self._test(call):
            self._items.append((call, target))

    def on_stray_reply(self, stray: StrayReply) -> None:
        self._stray_count += 1
        self._first_stray = self._first_stray or stray.observation.number
        if self._test is None:
            self._items.append((stray, None))

    def all_items(self) -> Iterator[tuple[PairingResult, TrackedObject | None]]:
        """Yield the selected calls and, without a filter, stray replies."""
        return self._reader.read_items(self._reader.pipeline(self, handles=self._handles), self._items)

    def calls(self) -> Iterator[tuple[Call, TrackedObject | None]]:
        for item, subject in self.all_items():
            if isinstance(item, Call):
                yield item, subject

    def filter_lines(self, item: PairingResult) -> Iterator[str]:
        reader = self._reader
        return display_filter_lines(
            map(reader.captures.origin_of, packets_of(item)),
            len(reader.captures.paths) > 1,
            reader.citing_words(),
        )

    def print_summary(self, words: MessageFormatter) -> None:
        """Print how many stray replies and repeated packets were captured, and list unclean sessions."""
        if self._stray_count:
            replies = Count(self._stray_count, "reply")
            print_stderr(words("calls.strays", replies=replies, frame=FramePlace((self._first_stray,))))
        if self._captured_again:
            print_stderr(words("calls.captured-again", packets=Count(self._captured_again, "packet")))
        unclean = [session for session in self._handles.sessions() if not session.is_clean]
        for session in unclean[:_MAX_SESSIONS_LISTED]:
            print_stderr(session_text(session, words))
        if len(unclean) > _MAX_SESSIONS_LISTED:
            print_stderr(words("calls.more-sessions", n=len(unclean) - _MAX_SESSIONS_LISTED))
