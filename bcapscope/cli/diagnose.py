"""``bcapscope diagnose``: what went wrong, the first cause first."""

from __future__ import annotations

import shutil
import sys

import click

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import palette
from bcapscope.cli.pairing import follow
from bcapscope.cli.reading import Reading
from bcapscope.render.findings import FindingsRenderer, finding_record
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS

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
    reading = Reading(paths, ports)
    diagnosis = _diagnose(reading, wanted)
    findings = diagnosis.finish(reading.ended)
    if as_json:
        records = (finding_record(number, finding) for number, finding in enumerate(findings, 1))
        reading.output.write_lines(records, reading.pause)
    elif diagnosis.seen.frames or reading.exit is not Exit.UNREADABLE:
        width = shutil.get_terminal_size((_PIPE_WIDTH, 24)).columns if sys.stdout.isatty() else _PIPE_WIDTH
        renderer = FindingsRenderer(palette(color), width)
        reading.output.write_lines(renderer.lines(findings, diagnosis.seen), reading.pause)
    reading.summary()
    sys.exit(reading.exit)


def _diagnose(reading: Reading, wanted: Filter | None) -> Diagnosis:
    """Show a reading to all rules, to its end."""
    chosen = None if wanted is None else wanted.bind(CALL_GETTERS)
    diagnosis = Diagnosis(chosen)
    follow(reading, diagnosis.take_observation, diagnosis.take)
    return diagnosis
