"""``bcapscope decode``: frames, one after the other."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from functools import partial
from itertools import chain, starmap
from typing import Any, TypeVar

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.live.standard_streams import choose_palette
from bcapscope.render.color_palette import Palette
from bcapscope.render.csv_table import CsvTableRenderer
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.frame_tree import FrameTreeRenderer
from bcapscope.render.hexdump import hexdump
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call_kind import CallKind, RecentRequests
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.observation import Observation

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


class FrameFormat(StrEnum):
    """How frames are written, if not as lines."""

    TREE = "tree"
    CSV = "csv"
    JSON = "json"


def _format_option(style: FrameFormat, text: str) -> Callable[[F], F]:
    return click.option(f"--{style}", "styles", flag_value=style, type=FrameFormat, multiple=True, help=text)


@click.command(short_help="Read frames, one line each.")
@options.paths
@options.interface
@click.option(
    "--text",
    metavar="FILE",
    help="Read hex as people paste it from mails, documents and tools; - is standard input.",
)
@options.ports
@_format_option(FrameFormat.TREE, "Every field, with its bytes.")
@_format_option(FrameFormat.CSV, "A table with a header.")
@_format_option(FrameFormat.JSON, "One JSON object a frame.")
@click.option("--hex", "dump", is_flag=True, help="A hexdump under each frame.")
@click.option("--full", is_flag=True, help="In trees, every byte and element of what is long.")
@options.filter_option(RecordKind.FRAME)
@options.time_format
@options.color
def command(
    *,
    paths: tuple[str, ...],
    interface: str | None,
    text: str | None,
    ports: tuple[int, ...],
    styles: tuple[FrameFormat, ...],
    dump: bool,
    full: bool,
    wanted: Filter | None,
    clock: str,
    color: str,
) -> None:
    """Read the frames of captures (pcap, pcapng, either may be gzipped; - is standard input).

    A line has: number, time, from > to, transport and kind, serial, reserved, then function or result,
    command and arguments, and after !! what is wrong with the bytes.

    Exit codes: 0 all was read; 2 invalid command line; 3 a capture is damaged or breaks off, all
    before the damage was given out; 4 nothing could be read; 6 the output could not be written; 130 Ctrl-C.
    """
    if len(set(styles)) > 1:
        raise click.UsageError(f"{' and '.join(f'--{style}' for style in styles)} exclude each other")
    style = styles[0] if styles else None
    if full and style is not FrameFormat.TREE:
        raise click.UsageError("--full goes with --tree")
    if dump and style in (FrameFormat.CSV, FrameFormat.JSON):
        raise click.UsageError("--hex goes with lines and trees")
    reading = CaptureReader(paths, ports, interface, text)
    if style is FrameFormat.JSON:
        lines: Iterable[str] | Iterable[bytes] = _render_frames(reading, wanted, FrameRecordRenderer().record)
    elif style is FrameFormat.CSV:
        table = CsvTableRenderer()
        rows = _render_frames(reading, wanted, lambda seen, question, _: table.row(seen, question))
        lines = chain([table.header()], rows)
    else:
        colors = choose_palette(color)
        line = FrameLineRenderer(TimeFormat(clock), colors, brief=text is not None)
        reading.on_first_time = line.set_time_origin
        if style is FrameFormat.TREE:
            lines = _with_details(
                _frames_with_context(reading, wanted), line, FrameTreeRenderer(colors, full, dump).lines
            )
        elif dump:
            dumped = partial(_hexdump_lines, colors)
            lines = _with_details(_frames_with_context(reading, wanted), line, dumped)
        elif text is not None:
            lines = _with_remarks(_frames_with_context(reading, wanted), line)
        else:
            lines = _render_frames(reading, wanted, line.line)
    reading.output.write_lines(lines, reading.show_progress)
    reading.print_summary()
    sys.exit(reading.exit_code)


def _frames_with_context(reader: CaptureReader, wanted: Filter | None) -> Iterator[AnnotatedFrame]:
    """Tell what each observation is about, and pass on those that are wanted."""
    told = _render_frames(reader, None, AnnotatedFrame)
    return told if wanted is None else filter(wanted.bind(FRAME_GETTERS), told)


def _render_frames(reader: CaptureReader, wanted: Filter | None, render: Callable[..., T]) -> Iterator[T]:
    """Render each observation that is wanted, with what it is about and what the capture has on it."""
    if wanted is not None:
        return starmap(render, _frames_with_context(reader, wanted))
    about, comments = RecentRequests().kind_of, reader.comments
    return (
        render(seen, about(seen), comments.get(seen.packet, ()) if comments else ())
        for seen in reader.observations()
    )


def _hexdump_lines(colors: Palette, observation: Observation, call_kind: CallKind | None) -> Iterator[str]:
    return hexdump(observation.item.raw, palette=colors)


def _with_details(
    frames: Iterable[AnnotatedFrame],
    line: FrameLineRenderer,
    details: Callable[[Observation, CallKind | None], Iterable[str]],
) -> Iterator[str]:
    for seen, question, comments in frames:
        yield line.line(seen, question, comments)
        for detail in details(seen, question):
            yield f"       {detail}"
        yield ""


def _with_remarks(frames: Iterable[AnnotatedFrame], line: FrameLineRenderer) -> Iterator[str]:
    for seen, question, comments in frames:
        yield line.line(seen, question)
        for remark in line.remarks(seen, comments):
            yield f"       {remark}"
