"""``bcapscope decode``: decode frames, one line each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from functools import partial
from itertools import starmap
from typing import Any, TypeVar

import click

from bcapscope.capture.capture_sequence import STDIN
from bcapscope.capture.packet import PacketOrigin
from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.column_options import column_renderer, columns_option, wide_option
from bcapscope.cli.common.data_output import folded_lines
from bcapscope.live.standard_streams import choose_palette
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.render.color_palette import Palette
from bcapscope.render.csv_table import CsvTableRenderer, csv_cell, csv_row
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.frame_record import FrameRecordRenderer, with_origin
from bcapscope.render.frame_tree import FrameTreeRenderer
from bcapscope.render.hexdump import hexdump
from bcapscope.render.record_columns import ColumnFormat, RecordColumn
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call_kind import CallKind, RecentRequests
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.observation import Observation

T = TypeVar("T")


class FrameFormat(StrEnum):
    TREE = "tree"
    CSV = "csv"
    JSON = "json"


@click.command()
@options.paths
@options.interface
@click.option(
    "--text",
    metavar="FILE",
    help="Read frames from a file of hex text, such as text copied from a mail or document; - is standard "
    "input.",
)
@options.ports
@options.choice_flag(FrameFormat.TREE, "styles", "Show every field with its bytes.")
@options.choice_flag(FrameFormat.CSV, "styles", "Print a CSV table with a header.")
@options.choice_flag(FrameFormat.JSON, "styles", "Print one JSON object per frame.")
@columns_option(RecordKind.FRAME)
@wide_option
@click.option("--hex", "dump", is_flag=True, help="Show a hex dump below each frame.")
@click.option("--full", is_flag=True, help="With --tree, show every byte and element of long values.")
@options.side
@options.filter_option(RecordKind.FRAME)
@options.time_format
@options.color
@options.language
def command(
    *,
    text: str | None,
    styles: tuple[FrameFormat, ...],
    columns: tuple[RecordColumn, ...] | None,
    wide: bool,
    dump: bool,
    full: bool,
    wanted: Filter | None,
    clock: str,
    color: str,
    words: MessageFormatter,
    **source: Any,
) -> None:
    """Decode the frames of captures, one line each.

    PATH is a capture (pcap or pcapng, plain or gzipped), a folder of captures, or - for standard input.
    Several captures are read as one, in the order of their first packets.

    Each line shows the number of a frame, its time, source > destination, transport, direction, serial and
    reserved. Further right, each line shows the function or the result, the command and the arguments. The
    line of a damaged frame ends with !! and a list of the problems. On a terminal, long lines are folded.

    Exit codes: 0: everything was read; 2: invalid command line; 3: a capture is damaged or incomplete, and
    everything before the damage was printed; 4: nothing could be read; 6: the output could not be written;
    130: Ctrl-C.
    """
    style = _choose_format(styles, columns is not None, dump, full)
    translated = words if columns is None and style in (None, FrameFormat.TREE) else ENGLISH_WORDS
    reading = CaptureReader(text=text, words=words, comment_words=translated, **source)
    palette = choose_palette(color)
    if columns is not None:
        renderer = column_renderer(RecordKind.FRAME, reading, columns, palette, wide)
        format_ = None if style is None else ColumnFormat(style.value)
        lines: Iterable[str] | Iterable[bytes] = renderer.lines(
            _frames_with_context(reading, wanted), format_
        )
    elif style is FrameFormat.JSON:
        record = _citing(reading, FrameRecordRenderer().record, with_origin)
        lines = _render_frames(reading, wanted, record)
    elif style is FrameFormat.CSV:
        lines = _csv_lines(reading, wanted)
    else:
        line = FrameLineRenderer(TimeFormat(clock), palette, brief=text is not None, words=words)
        reading.on_first_time = line.set_time_origin
        write_line = _citing(reading, line.line, partial(_line_with_origin, words))
        if style is FrameFormat.TREE or dump:
            tree = FrameTreeRenderer(palette, full, dump, words) if style else None
            details = partial(_frame_details, tree, palette)
            lines = _with_details(_frames_with_context(reading, wanted), write_line, details, ends=("",))
        elif text is not None:
            lines = _with_details(
                _frames_with_context(reading, wanted),
                lambda seen, kind, comments: line.line(seen, kind),
                lambda frame: line.remarks(frame.observation, frame.comments),
            )
        else:
            lines = folded_lines(_render_frames(reading, wanted, write_line), wide)
    reading.print_lines(lines)
    reading.finish()


def _choose_format(
    styles: tuple[FrameFormat, ...], has_columns: bool, dump: bool, full: bool
) -> FrameFormat | None:
    if len(set(styles)) > 1:
        raise click.UsageError(f"{' and '.join(f'--{style}' for style in styles)} exclude each other")
    style = styles[0] if styles else None
    if full and style is not FrameFormat.TREE:
        raise click.UsageError("--full has no effect without --tree: add --tree")
    if dump and style in (FrameFormat.CSV, FrameFormat.JSON):
        raise click.UsageError("--hex cannot be combined with --csv or --json: remove --hex")
    if has_columns and (dump or style is FrameFormat.TREE):
        raise click.UsageError("--columns excludes --tree and --hex")
    return style


def _csv_lines(reader: CaptureReader, wanted: Filter | None) -> Iterator[str]:
    table, several = CsvTableRenderer(), len(reader.captures.paths) > 1

    def row(seen: Observation, call_kind: CallKind | None, comments: tuple[str, ...]) -> str:
        cells = table.row(seen, call_kind)
        if not several:
            return cells
        origin = reader.captures.origin_of(seen.packet)
        return f"{cells},{csv_row(('', '') if origin is None else (csv_cell(origin.path), origin.packet))}"

    yield table.header() + (",file,file_packet" if several else "")
    yield from _render_frames(reader, wanted, row)


def _citing(
    reader: CaptureReader,
    render: Callable[[Observation, CallKind | None, tuple[str, ...]], T],
    cite: Callable[[T, PacketOrigin], T],
) -> Callable[[Observation, CallKind | None, tuple[str, ...]], T]:
    """Return `render`. With several captures, `cite` adds the origin of the frame to each result."""
    if len(reader.captures.paths) < 2:
        return render

    def rendered(seen: Observation, call_kind: CallKind | None, comments: tuple[str, ...]) -> T:
        result, origin = render(seen, call_kind, comments), reader.captures.origin_of(seen.packet)
        return result if origin is None else cite(result, origin)

    return rendered


def _line_with_origin(words: MessageFormatter, line: str, origin: PacketOrigin) -> str:
    name = words("reading.stdin") if origin.name == STDIN else printable(origin.name)
    return f"{line}  ({words('frames.origin', file=name, packets=origin.packet)})"


def _frames_with_context(reader: CaptureReader, wanted: Filter | None) -> Iterator[AnnotatedFrame]:
    frames = _render_frames(reader, None, AnnotatedFrame)
    if wanted is None:
        return frames
    test = reader.record_test(wanted, FRAME_GETTERS, lambda frame: frame.observation.number)
    return filter(test, frames)


def _render_frames(reader: CaptureReader, wanted: Filter | None, render: Callable[..., T]) -> Iterator[T]:
    """Call `render` for each selected frame, and yield the results. The arguments of `render` are the frame,
    the frame's kind of call, and the comments on the frame's packet.
    """
    if wanted is not None:
        return starmap(render, _frames_with_context(reader, wanted))
    about, comments = RecentRequests().kind_of, reader.comments
    return (
        render(seen, about(seen), comments.get(seen.packet, ()) if comments else ())
        for seen in reader.observations()
    )


def _frame_details(tree: FrameTreeRenderer | None, palette: Palette, frame: AnnotatedFrame) -> Iterable[str]:
    if tree is None:
        return hexdump(frame.observation.item.raw, palette=palette)
    return tree.lines(frame.observation, frame.call_kind)


def _with_details(
    frames: Iterable[AnnotatedFrame],
    write_line: Callable[[Observation, CallKind | None, tuple[str, ...]], str],
    details: Callable[[AnnotatedFrame], Iterable[str]],
    ends: Sequence[str] = (),
) -> Iterator[str]:
    for frame in frames:
        yield write_line(*frame)
        for detail in details(frame):
            yield f"       {detail}"
        yield from ends
