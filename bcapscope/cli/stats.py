"""``bcapscope stats``: figures by client and command."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

import click

from bcapscope.analysis.statistics import Slices, Statistics, Summary
from bcapscope.cli import options
from bcapscope.cli.output import palette
from bcapscope.cli.pairing import wanted_calls
from bcapscope.cli.reading import Reading
from bcapscope.render.statistics import statistics_lines, statistics_record
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter


@click.command(short_help="Figures by client and command: rates, latencies, retries, refusals.")
@options.captures
@options.ports
@click.option("--json", "as_json", is_flag=True, help="One JSON object; with --window one a slice.")
@options.window
@options.filter_option(RecordKind.CALL)
@options.color
def command(
    *,
    paths: tuple[str, ...],
    ports: tuple[int, ...],
    as_json: bool,
    window: int | None,
    wanted: Filter | None,
    color: str,
) -> None:
    """Sum up the calls of captures.

    Line time is the share of the whole time that the client spent waiting for replies of that kind. Latencies
    run from the first request to the accepted reply.

    Exit codes: as of decode.
    """
    reading = Reading(paths, ports)
    calls = wanted_calls(reading, wanted)
    found = _slices(calls, window) if window else _whole(calls)
    colors = palette(color)
    if as_json:
        reading.output.write_lines(map(statistics_record, found), reading.pause)
    else:
        lines = (line for statistics in found for line in (*statistics_lines(statistics, colors), ""))
        reading.output.write_lines(lines, reading.pause)
    reading.summary()
    sys.exit(reading.exit)


def _whole(calls: Iterable[Exchange]) -> Iterator[Statistics]:
    summary = Summary()
    for call in calls:
        summary.take(call)
    statistics = summary.statistics()
    if statistics is not None:
        yield statistics


def _slices(calls: Iterable[Exchange], window: int) -> Iterator[Statistics]:
    slices = Slices(window)
    for call in calls:
        yield from slices.take(call)
    yield from slices.close()
