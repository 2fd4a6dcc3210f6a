"""``bcapscope compare``: what differs between two captures."""

from __future__ import annotations

import sys

import click

from bcapscope.analysis.comparison import MOST_STAYS, Side, compare
from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.statistics import Summary
from bcapscope.analysis.stay import Stay
from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate, palette
from bcapscope.cli.pairing import follow
from bcapscope.cli.reading import Reading
from bcapscope.render.comparison import comparison_lines, comparison_record
from bcapscope.render.escape import printable
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS

_path = click.Path(allow_dash=True)


@click.command(short_help="What differs between a good capture and a bad one.")
@click.argument("good", type=_path)
@click.argument("bad", type=_path)
@options.ports
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
@options.filter_option(RecordKind.CALL)
@options.color
def command(
    *, good: str, bad: str, ports: tuple[int, ...], as_json: bool, wanted: Filter | None, color: str
) -> None:
    """Tell what differs between two captures, in the figures of stats and slave and the findings of diagnose.

    What two good runs would not differ by stands first. Calls of the same function and command are compared
    with each other, all clients together; stays in slave mode in the order in which they began. A filter
    chooses calls in both, as it does for stats, slave and diagnose.

    Exit codes: as of decode, whichever capture was worse; 4 if either could not be read.
    """
    if good == bad == "-":
        raise click.UsageError("standard input can be only one of the two")
    readings = [Reading([path], ports) for path in (good, bad)]
    named = list(zip((good, bad), readings, strict=True))
    first, second = (_side(path, reading, wanted) for path, reading in named)
    for path, reading in named:
        narrate(f"{printable(path)}:")
        reading.summary()
    code = max(reading.exit for reading in readings)
    if code < Exit.UNREADABLE:
        found = compare(first, second)
        output, pause = readings[1].output, readings[1].pause
        if as_json:
            output.write_lines([comparison_record(found, first, second)], pause)
        else:
            output.write_lines(comparison_lines(found, first, second, palette(color)), pause)
    sys.exit(code)


def _side(path: str, reading: Reading, wanted: Filter | None) -> Side:
    """Read a capture to its end, once."""
    stays: list[Stay] = []
    chosen = None if wanted is None else wanted.bind(CALL_GETTERS)
    diagnosis, summary = Diagnosis(chosen, stays.append), Summary()

    def take(settled: Settled) -> None:
        diagnosis.take(settled)
        if isinstance(settled, Exchange) and (chosen is None or chosen(settled)):
            summary.take(settled)
        del stays[MOST_STAYS:]

    follow(reading, diagnosis.take_observation, take)
    findings = diagnosis.finish(reading.ended)
    first = sorted(stays, key=lambda stay: stay.number)[:MOST_STAYS]
    return Side(path, summary.statistics(), tuple(first), findings)
