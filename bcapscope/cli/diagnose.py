"""``bcapscope diagnose``: explain what went wrong, root cause first."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from typing import Any

import click

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.rules.rule_table import RULES
from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.messages import Message, MessageFormatter
from bcapscope.render.display_filter import display_filter_lines
from bcapscope.render.findings import FindingsRenderer, finding_record
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.tokens import with_nearest

_PIPE_WIDTH = 100
_SEVERITY = click.Choice([each.value for each in Severity])
_RANK = {severity: rank for rank, severity in enumerate(Severity)}


def _known_rule(rule_id: str) -> str:
    if rule_id not in RULES:
        unknown = Message("diagnose.no-such-rule", rule=f"{rule_id!r}")
        raise ValueError(str(with_nearest(unknown, rule_id, RULES)))
    return rule_id


@click.command()
@options.paths
@options.interface
@options.ports
@options.side
@options.taken_at
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per finding.")
@click.option(
    "--rule",
    "rules",
    metavar="ID",
    multiple=True,
    callback=options.parsed_by(_known_rule),
    help="Show only findings of this rule; may be repeated. docs/rules.md lists the rules.",
)
@click.option(
    "--severity",
    "severities",
    type=_SEVERITY,
    multiple=True,
    help="Show only findings of this severity; may be repeated.",
)
@click.option(
    "--fail-on", type=_SEVERITY, help="Exit with 1 if `diagnose` shows a finding of this severity or worse."
)
@options.display_filter_option("finding")
@options.filter_option(RecordKind.CALL)
@options.color
@options.language
def command(
    *,
    interface: str | None,
    as_json: bool,
    rules: tuple[str, ...],
    severities: tuple[str, ...],
    fail_on: str | None,
    display_filter: bool,
    wanted: Filter | None,
    color: str,
    words: MessageFormatter,
    **source: Any,
) -> None:
    """Find problems in captures and print findings, root cause first.

    A finding has a number, a severity and a rule. Each finding says what happened, which frames prove it,
    what to do, and which source the rule is based on. Consequences are indented below their root cause.
    docs/rules.md lists the rules.

    With -i, or on a pipe (-), each new finding is printed to stderr immediately. The full report is printed
    when the traffic ends. With --json, new findings go to stdout, with "final": false.

    --filter selects calls: `diagnose` shows only findings about the selected calls, and their causes. Even
    with --filter, the rules check all calls, because most rules depend on more than one call. With --rule
    or --severity, `diagnose` omits findings of all other rules or severities.

    Exit codes: 0: everything was read, with or without findings; 1: everything was read, and a finding has
    the severity of --fail-on or is worse; other codes as for `decode`.
    """
    if display_filter and (as_json or interface is not None):
        raise click.UsageError("--display-filter needs captures, and cannot be combined with --json")
    reading = CaptureReader(interface=interface, words=words, **source)
    diagnosis = Diagnosis(reading.call_test(wanted))
    width = shutil.get_terminal_size((_PIPE_WIDTH, 24)).columns if sys.stdout.isatty() else _PIPE_WIDTH
    filter_lines = partial(_filter_lines, reading) if display_filter else None
    renderer = FindingsRenderer(choose_palette(color), width, reading.citing_words(), filter_lines)

    def is_shown(finding: Finding) -> bool:
        is_chosen = not rules or finding.rule in rules
        return is_chosen and (not severities or finding.severity in severities)

    if as_json or display_filter:
        reading.remember_origins()
    if reading.is_live:
        _read_live(reading, diagnosis, is_shown, None if as_json else renderer)
    else:
        reading.read_to_end(diagnosis)
    findings, totals = diagnosis.findings(reading.ended_at), diagnosis.totals(reading.ended_at)
    if as_json:
        origin_of = reading.origin_of_frame
        numbered = [(number, each) for number, each in enumerate(findings, 1) if is_shown(each)]
        reading.print_lines(finding_record(number, each, totals, origin_of) for number, each in numbered)
    elif totals.frames or reading.exit_code is not ExitCode.UNREADABLE:
        reading.print_lines(renderer.lines(findings, totals, is_shown))
    reading.print_summary()
    sys.exit(reading.exit_code or _findings_code(list(filter(is_shown, findings)), fail_on))


def _filter_lines(reader: CaptureReader, finding: Finding) -> Iterator[str]:
    origins = map(reader.origin_of_frame, finding.frames)
    return display_filter_lines(origins, len(reader.captures.paths) > 1, reader.citing_words())


def _read_live(
    reader: CaptureReader,
    diagnosis: Diagnosis,
    is_shown: Callable[[Finding], bool],
    renderer: FindingsRenderer | None,
) -> None:
    """Print each new finding immediately: as text with `renderer`, or as JSON if `renderer` is None."""
    pipeline, numbers = reader.pipeline(diagnosis), count(1)

    def print_new() -> None:
        for finding in filter(is_shown, diagnosis.new_findings()):
            totals = diagnosis.totals()
            if renderer is not None:
                print_stderr(renderer.new_finding_line(finding, totals))
                continue
            origin_of = reader.origin_of_frame
            reader.print_lines([finding_record(next(numbers), finding, totals, origin_of, is_final=False)])

    def expire(now: int) -> None:
        pipeline.expire(now)
        print_new()

    reader.on_idle = expire
    for observation in reader.observations():
        pipeline.add(observation)
        print_new()
    pipeline.finish(reader.ended_at)


def _findings_code(shown: Sequence[Finding], fail_on: str | None) -> ExitCode:
    if fail_on is None:
        return ExitCode.OK
    limit = _RANK[Severity(fail_on)]
    return ExitCode.FINDINGS if any(_RANK[each.severity] <= limit for each in shown) else ExitCode.OK
