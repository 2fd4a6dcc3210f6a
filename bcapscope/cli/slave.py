"""``bcapscope slave``: stays in slave mode."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

import click

from bcapscope.analysis.slave import ChosenStays
from bcapscope.analysis.stay import Stay
from bcapscope.cli.exits import Exit
from bcapscope.cli.figures import Asked, figures
from bcapscope.cli.output import narrate
from bcapscope.cli.pairing import settle
from bcapscope.render.slave import stay_lines
from bcapscope.render.slave_record import stay_record
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.getters import CALL_GETTERS


@click.command(short_help="Slave mode: cycle times, retries, the controller's buffer, clock and motion.")
@figures("One JSON object a stay.")
def command(asked: Asked) -> None:
    """Tell about each stay in slave mode: who entered and how it ended, when set points were sent and
    answered, and what they command.

    The cycle is the time between the first requests of successive set points, jitter its distance from the
    grid. Latency runs from the first request to the accepted reply, the round trip from the request that it
    answers. What the controller's buffer held is predicted by a model, which tells what it takes for granted.

    A filter chooses set points; what begins and ends a stay is followed all the same.

    Exit codes: as of decode.
    """
    reading = asked.reading
    stays = _told(_stays(asked), asked)
    if asked.as_json:
        reading.output.write_lines(map(stay_record, stays), reading.pause)
    else:
        lines = (line for stay in stays for line in (*stay_lines(stay, asked.palette), ""))
        reading.output.write_lines(lines, reading.pause)
    reading.summary()
    sys.exit(reading.exit)


def _stays(asked: Asked) -> Iterator[Stay]:
    watcher = ChosenStays(None if asked.wanted is None else asked.wanted.bind(CALL_GETTERS), asked.window)
    take = watcher.take
    for item in settle(asked.reading):
        if isinstance(item, Exchange):
            ended = take(item)
            if ended:
                yield from ended
    yield from watcher.finish(asked.reading.ended)


def _told(stays: Iterable[Stay], asked: Asked) -> Iterator[Stay]:
    """Pass stays on; tell if there is none in what was read."""
    none = True
    for stay in stays:
        none = False
        yield stay
    if none and asked.reading.exit is not Exit.UNREADABLE:
        narrate("no slave mode here" if asked.wanted is None else "no set point fits the filter")
