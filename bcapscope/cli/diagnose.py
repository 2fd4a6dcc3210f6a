"""``bcapscope diagnose``: what went wrong, the first cause first."""

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
from bcapscope.render.findings import FindingsRenderer, finding_record
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS

_PIPE_WIDTH = 100


@click.command(short_help="Tell what went wrong, the first cause first.")
@options.captures
@options.ports
@click.option("--json", "as_json", is_flag=True, help="One JSON object a finding.")
@options.filter_option(RecordKind.CALL)
@options.color
def command(
    *, paths: tuple[str, ...], ports: tuple[int, ...], as_json: bool, wanted: Filter | None, color: str
) -> None:
    """Look for what went wrong in captures, and tell the first cause first.

    A finding has: number, severity, rule, one sentence, the frames that prove it, what to do, and where the
    rule is from. Consequences stand under their cause. docs/rules.md lists the rules.

    A filter chooses calls: told is what concerns them and what that follows from. The rules see all calls
    even so, as most of them reason about what came before, or never came.

    Exit codes: 0 all was read, whether or not something was found; else as of decode.
    """
    reading = CaptureReader(paths, ports)
    diagnosis = _diagnose(reading, wanted)
    findings = diagnosis.finish(reading.ended_at)
    if as_json:
        records = (finding_record(number, finding) for number, finding in enumerate(findings, 1))
        reading.output.write_lines(records, reading.show_progress)
    elif diagnosis.totals.frames or reading.exit_code is not ExitCode.UNREADABLE:
        width = shutil.get_terminal_size((_PIPE_WIDTH, 24)).columns if sys.stdout.isatty() else _PIPE_WIDTH
        renderer = FindingsRenderer(choose_palette(color), width)
        reading.output.write_lines(renderer.lines(findings, diagnosis.totals), reading.show_progress)
    reading.print_summary()
    sys.exit(reading.exit_code)


def _diagnose(reader: CaptureReader, wanted: Filter | None) -> Diagnosis:
    """Show a reading to all rules, to its end."""
    chosen = None if wanted is None else wanted.bind(CALL_GETTERS)
    diagnosis = Diagnosis(chosen)
    read_to_end(reader, diagnosis.on_observation, diagnosis.on_pairing_result)
    return diagnosis
