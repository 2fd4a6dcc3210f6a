"""``bcapscope diagnose``: explain what went wrong, root cause first."""

from __future__ import annotations

import shutil
import sys

import click

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.cli.common.call_reading import call_test, read_to_end
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.figure_command import FigureArguments, figure_command
from bcapscope.render.findings import FindingsRenderer, finding_record

_PIPE_WIDTH = 100


@click.command(short_help="Explain what went wrong, root cause first.")
@figure_command("Print one JSON object per finding.", windows=False)
def command(arguments: FigureArguments) -> None:
    """Find problems in captures and print findings, root cause first.

    A finding has a number, a severity and a rule. Each finding says what happened, which frames prove it,
    what to do, and what the source of the rule is. Consequences are indented below their root cause.
    docs/rules.md lists the rules.

    --filter selects calls: `diagnose` shows only findings about the selected calls, and their causes. The
    rules still read all calls, because most of them depend on earlier or missing calls.

    Exit codes: 0: everything was read, with or without findings; the others as for `decode`.
    """
    reading, diagnosis = arguments.reader, Diagnosis(call_test(arguments.call_filter))
    read_to_end(reading, reading.pipeline(diagnosis))
    findings, totals = diagnosis.findings(reading.ended_at), diagnosis.totals(reading.ended_at)
    if arguments.as_json:
        reading.print_lines(finding_record(number, each, totals) for number, each in enumerate(findings, 1))
    elif totals.frames or reading.exit_code is not ExitCode.UNREADABLE:
        width = shutil.get_terminal_size((_PIPE_WIDTH, 24)).columns if sys.stdout.isatty() else _PIPE_WIDTH
        renderer = FindingsRenderer(arguments.palette, width, arguments.words)
        reading.print_lines(renderer.lines(findings, totals))
    reading.finish()
