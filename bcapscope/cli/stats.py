"""``bcapscope stats``: show figures by client and command."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import click

from bcapscope.analysis.statistics.call_statistics import SlicedStatistics, Statistics, StatisticsBuilder
from bcapscope.cli.common.figure_command import FigureArguments, figure_options
from bcapscope.render.statistics_text import (
    statistics_header,
    statistics_lines,
    statistics_record,
    statistics_rows,
)


@click.command()
@figure_options("Print one JSON object; with --window, one per window.", has_csv=True)
def command(**given: Any) -> None:
    """Show figures about the calls in captures, by client and by command.

    Each row shows the figures of all calls, of one client, or of one command of a client. The column
    "line time" shows the sum of the latencies of a row's calls, as a percentage of the total time.
    Latency is the time from the first attempt of a call to its accepted reply.

    Exit codes: as for `decode`.
    """
    arguments = FigureArguments(**given)
    found = _by_window(arguments, arguments.window) if arguments.window else _whole_time(arguments)
    if arguments.as_csv:
        rows = chain.from_iterable(map(statistics_rows, found))
        arguments.reader.print_lines(chain([statistics_header()], rows))
        arguments.reader.finish()
    arguments.print_all(found, statistics_record, statistics_lines)


def _whole_time(arguments: FigureArguments) -> Iterator[Statistics]:
    summary = StatisticsBuilder(arguments.reader.call_test(arguments.call_filter))
    arguments.reader.read_to_end(summary)
    statistics = summary.statistics()
    if statistics is not None:
        yield statistics


def _by_window(arguments: FigureArguments, window: int) -> Iterator[Statistics]:
    slices = SlicedStatistics(window)
    for call in arguments.reader.read_calls(arguments.call_filter):
        yield from slices.add_call(call)
    yield from slices.close()
