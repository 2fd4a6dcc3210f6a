"""``bcapscope stats``: figures by client and command."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

import click

from bcapscope.analysis.statistics import Slices, Statistics, Summary
from bcapscope.cli.figures import Asked, figures
from bcapscope.cli.pairing import wanted_calls
from bcapscope.render.statistics import statistics_lines, statistics_record
from bcapscope.traffic.exchange import Exchange


@click.command(short_help="Figures by client and command: rates, latencies, retries, refusals.")
@figures("One JSON object; with --window one a slice.")
def command(asked: Asked) -> None:
    """Sum up the calls of captures.

    Line time is the share of the whole time that the client spent waiting for replies of that kind. Latencies
    run from the first request to the accepted reply.

    Exit codes: as of decode.
    """
    reading = asked.reading
    calls = wanted_calls(reading, asked.wanted)
    found = _slices(calls, asked.window) if asked.window else _whole(calls)
    if asked.as_json:
        reading.output.write_lines(map(statistics_record, found), reading.pause)
    else:
        lines = (line for statistics in found for line in (*statistics_lines(statistics, asked.palette), ""))
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
