"""``bcapscope compare``: show the differences between two captures."""

from __future__ import annotations

import sys
from bisect import insort
from typing import Any

import click

from bcapscope.analysis.capture_comparison import MAX_SESSIONS, ComparedCapture, compare
from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import StatisticsBuilder
from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.messages import MessageFormatter
from bcapscope.render.comparison_text import comparison_lines, comparison_record
from bcapscope.render.escape import printable
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind

_path = click.Path(allow_dash=True)


@click.command()
@click.argument("good", type=_path)
@click.argument("bad", type=_path)
@options.ports
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@options.side
@options.taken_at
@options.filter_option(RecordKind.CALL)
@options.color
@options.language
def command(
    *,
    good: str,
    bad: str,
    as_json: bool,
    wanted: Filter | None,
    color: str,
    words: MessageFormatter,
    **source: Any,
) -> None:
    """Compare two captures: their figures in `stats` and `slave`, and their findings in `diagnose`.

    Notable differences come first. A difference is notable if it is larger than the usual differences between
    two good captures. Calls are compared by function and command; the calls of all clients are counted
    together. Slave-mode sessions are compared in the order in which they began.

    --filter selects calls in both captures, as for `stats`, `slave` and `diagnose`.

    Exit codes: as for `decode`. If the two captures give different codes, `compare` exits with the higher
    code. 4: one of the captures could not be read.
    """
    if good == bad == "-":
        raise click.UsageError("both captures are standard input (-): give a file for one of them")
    readings = [CaptureReader([path], words=words, **source) for path in (good, bad)]
    named = list(zip((good, bad), readings, strict=True))
    first, second = (_read_side(path, reading, wanted) for path, reading in named)
    for path, reading in named:
        print_stderr(f"{printable(path)}:")
        reading.print_summary()
    code = max(reading.exit_code for reading in readings)
    if code < ExitCode.UNREADABLE:
        found = compare(first, second)
        if as_json:
            readings[1].print_lines([comparison_record(found, first, second)])
        else:
            lines = comparison_lines(found, first, second, choose_palette(color), words)
            readings[1].print_lines(lines)
    sys.exit(code)


def _read_side(path: str, reader: CaptureReader, wanted: Filter | None) -> ComparedCapture:
    sessions: list[SlaveSession] = []
    chosen = reader.call_test(wanted)

    def keep_if_early(session: SlaveSession) -> None:
        insort(sessions, session, key=lambda each: each.number)
        del sessions[MAX_SESSIONS:]

    diagnosis, figures = Diagnosis(chosen, keep_if_early), StatisticsBuilder(chosen)
    reader.read_to_end(diagnosis, figures)
    for session in diagnosis.remaining_sessions(reader.ended_at):
        keep_if_early(session)
    findings, totals = diagnosis.findings(reader.ended_at), diagnosis.totals(reader.ended_at)
    return ComparedCapture(path, figures.statistics(), tuple(sessions), findings, totals)
