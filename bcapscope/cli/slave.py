"""``bcapscope slave``: stays in slave mode."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

import click

from bcapscope.analysis.slave import ChosenStays
from bcapscope.analysis.stay import Stay
from bcapscope.cli import options
from bcapscope.cli.output import narrate, palette
from bcapscope.cli.pairing import settle
from bcapscope.cli.reading import Reading
from bcapscope.render.slave import stay_lines
from bcapscope.render.slave_record import stay_record
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS


@click.command(short_help="Slave mode: cycle times, retries, the controller's buffer, clock and motion.")
@options.captures
@options.ports
@click.option("--json", "as_json", is_flag=True, help="One JSON object a stay.")
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
    """Tell about each stay in slave mode: who entered and how it ended, when set points were sent and
    answered, and what they command.

    The cycle is the time between the first requests of successive set points, jitter its distance from the
    grid. Latency runs from the first request to the accepted reply, the round trip from the request that it
    answers. What the controller's buffer held is predicted by a model, which tells what it takes for granted.

    A filter chooses set points; what begins and ends a stay is followed all the same.

    Exit codes: as of decode.
    """
    reading = Reading(paths, ports)
    stays = _told(_stays(settle(reading), window, wanted), wanted is not None)
    if as_json:
        reading.output.write_lines(map(stay_record, stays), reading.pause)
    else:
        colors = palette(color)
        lines = (line for stay in stays for line in (*stay_lines(stay, colors), ""))
        reading.output.write_lines(lines, reading.pause)
    reading.summary()
    sys.exit(reading.exit)


def _stays(settled: Iterable[Settled], window: int | None, wanted: Filter | None) -> Iterator[Stay]:
    watcher = ChosenStays(None if wanted is None else wanted.bind(CALL_GETTERS), window)
    take = watcher.take
    for item in settled:
        if isinstance(item, Exchange):
            ended = take(item)
            if ended:
                yield from ended
    yield from watcher.finish()


def _told(stays: Iterable[Stay], chosen: bool) -> Iterator[Stay]:
    """Pass stays on; tell if there is none."""
    none = True
    for stay in stays:
        none = False
        yield stay
    if none:
        narrate("no set point fits the filter" if chosen else "no slave mode here")
