"""``bcapscope decode``: frames, one after the other."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from functools import partial
from itertools import chain, starmap
from typing import Any, TypeVar

import click

from bcapscope.cli import options
from bcapscope.cli.output import palette
from bcapscope.cli.reading import Reading
from bcapscope.render.hexdump import hexdump
from bcapscope.render.line import LineRenderer
from bcapscope.render.moment import Clock
from bcapscope.render.palette import Palette
from bcapscope.render.record import RecordRenderer
from bcapscope.render.table import TableRenderer
from bcapscope.render.tree import TreeRenderer
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import FRAME_GETTERS, Told
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.question import Question, Questions

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


class Style(StrEnum):
    """How frames are written, if not as lines."""

    TREE = "tree"
    CSV = "csv"
    JSON = "json"


def _style(style: Style, text: str) -> Callable[[F], F]:
    return click.option(f"--{style}", "styles", flag_value=style, type=Style, multiple=True, help=text)


@click.command(short_help="Read frames, one line each.")
@options.paths
@options.interface
@click.option(
    "--text",
    metavar="FILE",
    help="Read hex as people paste it from mails, documents and tools; - is standard input.",
)
@options.ports
@_style(Style.TREE, "Every field, with its bytes.")
@_style(Style.CSV, "A table with a header.")
@_style(Style.JSON, "One JSON object a frame.")
@click.option("--hex", "dump", is_flag=True, help="A hexdump under each frame.")
@click.option("--full", is_flag=True, help="In trees, every byte and element of what is long.")
@options.filter_option(RecordKind.FRAME)
@options.clock
@options.color
def command(
    *,
    paths: tuple[str, ...],
    interface: str | None,
    text: str | None,
    ports: tuple[int, ...],
    styles: tuple[Style, ...],
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
    if full and style is not Style.TREE:
        raise click.UsageError("--full goes with --tree")
    if dump and style in (Style.CSV, Style.JSON):
        raise click.UsageError("--hex goes with lines and trees")
    reading = Reading(paths, ports, interface, text)
    if style is Style.JSON:
        lines: Iterable[str] | Iterable[bytes] = _rendered(reading, wanted, RecordRenderer().record)
    elif style is Style.CSV:
        table = TableRenderer()
        rows = _rendered(reading, wanted, lambda seen, question, _: table.row(seen, question))
        lines = chain([table.header()], rows)
    else:
        colors = palette(color)
        line = LineRenderer(Clock(clock), colors, brief=text is not None)
        reading.begin = line.begin
        if style is Style.TREE:
            lines = _detailed(_told(reading, wanted), line, TreeRenderer(colors, full, dump).lines)
        elif dump:
            dumped = partial(_dumped, colors)
            lines = _detailed(_told(reading, wanted), line, dumped)
        elif text is not None:
            lines = _remarked(_told(reading, wanted), line)
        else:
            lines = _rendered(reading, wanted, line.line)
    reading.output.write_lines(lines, reading.pause)
    reading.summary()
    sys.exit(reading.exit)


def _told(reading: Reading, wanted: Filter | None) -> Iterator[Told]:
    """Tell what each observation is about, and pass on those that are wanted."""
    told = _rendered(reading, None, Told)
    return told if wanted is None else filter(wanted.bind(FRAME_GETTERS), told)


def _rendered(reading: Reading, wanted: Filter | None, render: Callable[..., T]) -> Iterator[T]:
    """Render each observation that is wanted, with what it is about and what the capture has on it."""
    if wanted is not None:
        return starmap(render, _told(reading, wanted))
    about, comments = Questions().about, reading.comments
    return (
        render(seen, about(seen), comments.get(seen.packet, ()) if comments else ())
        for seen in reading.observations()
    )


def _dumped(colors: Palette, seen: Observation, question: Question | None) -> Iterator[str]:
    return hexdump(seen.item.raw, palette=colors)


def _detailed(
    told: Iterable[Told],
    line: LineRenderer,
    details: Callable[[Observation, Question | None], Iterable[str]],
) -> Iterator[str]:
    for seen, question, comments in told:
        yield line.line(seen, question, comments)
        for detail in details(seen, question):
            yield f"       {detail}"
        yield ""


def _remarked(told: Iterable[Told], line: LineRenderer) -> Iterator[str]:
    for seen, question, comments in told:
        yield line.line(seen, question)
        for remark in line.remarks(seen, comments):
            yield f"       {remark}"
