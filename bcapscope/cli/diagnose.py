"""``bcapscope diagnose``: explain what went wrong, root cause first."""

from __future__ import annotations

import shutil
import sys

import click

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.cli.common import options
from bcapscope.cli.common.call_reading import read_to_end
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.standard_streams import choose_palette
from bcapscope.messages import MessageFormatter
from bcapscope.render.findings import FindingsRenderer, finding_record
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.pipeline import Pipeline

_PIPE_WIDTH = 100


@click.command(short_help="Explain what went wrong, root cause first.")
@options.captures
@options.ports
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per finding.")
@options.filter_option(RecordKind.CALL)
@options.color
@options.language
def command(
    *,
    paths: tuple[str, ...],
    ports: tuple[int, ...],
    as_json: bool,
    wanted: Filter | None,
    color: str,
    words: MessageFormatter,
) -> None:
    """Find problems in captures and print findings, root cause first.

    A finding has a number, a severity and a rule. It says what happened, which frames prove it, what to do,
    and what the source of the rule is. Consequences are indented below their root cause. docs/rules.md lists
    the rules.

    --filter selects calls: `diagnose` shows only findings about the selected calls, and their causes. The
    rules still read all calls, because most of them depend on earlier or missing calls.

    Exit codes: 0: everything was read, with or without findings; the others as for `decode`.
    """
    reading = CaptureReader(paths, ports, words=words)
    diagnosis = _diagnose(reading, wanted)
    findings, totals = diagnosis.findings(reading.ended_at), diagnosis.totals(reading.ended_at)
    if as_json:
        records = (finding_record(number, finding, totals) for number, finding in enumerate(findings, 1))
        reading.output.write_lines(records, reading.show_progress)
    elif totals.frames or reading.exit_code is not ExitCode.UNREADABLE:
        width = shutil.get_terminal_size((_PIPE_WIDTH, 24)).columns if sys.stdout.isatty() else _PIPE_WIDTH
        renderer = FindingsRenderer(choose_palette(color), width, words)
        reading.output.write_lines(renderer.lines(findings, totals), reading.show_progress)
    reading.print_summary()
    sys.exit(reading.exit_code)


def _diagnose(reader: CaptureReader, wanted: Filter | None) -> Diagnosis:
    """Read to the end and apply all rules."""
    chosen = None if wanted is None else wanted.bind(CALL_GETTERS)
    diagnosis = Diagnosis(chosen)
    read_to_end(reader, Pipeline(diagnosis))
    return diagnosis
