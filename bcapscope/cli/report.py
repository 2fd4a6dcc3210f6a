"""``bcapscope report``: write one HTML page about captures."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from bcapscope import __version__
from bcapscope.analysis.report_data import ReportData, ReportDataBuilder
from bcapscope.capture.capture_sequence import STDIN
from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.cli.common.output_files import AtomicFile, check_output_path, force_option
from bcapscope.errors import MissingExtraError
from bcapscope.live.end_signals import interrupt_on_end_signals
from bcapscope.messages import MessageFormatter
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind

_NEEDED = ("jinja2", "plotly")


@click.command()
@options.captures
@options.output_option("Write the page to this file, such as report.html; - is stdout.", allow_dash=True)
@options.ports
@options.side
@options.taken_at
@options.filter_option(RecordKind.CALL)
@force_option
@options.language
def command(
    *, output: Path, wanted: Filter | None, force: bool, words: MessageFormatter, **source: Any
) -> None:
    """Write a report about captures: one HTML page that needs no network and no other file.

    The page has a summary, the findings of `diagnose` and a timeline. Tables and charts show the cycle times
    of slave mode, the latencies of calls, and retries. The report needs plotly and Jinja2:
    pip install 'bcapscope[report]'.

    --filter selects calls, as for `stats`, `slave` and `diagnose`. The page shows the filter.

    Exit codes: 0: the page was written; 2: invalid command line; 3: a capture is damaged or incomplete, and
    the page covers everything before the damage; 4: nothing could be read; 5: the captures contain no b-CAP,
    so no page was written; 6: the page could not be written; 7: plotly or Jinja2 is not
    installed.
    """
    try:
        from bcapscope.render.report_page import report_page
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in _NEEDED:
            raise
        exit_with(str(MissingExtraError(missing, "report")), ExitCode.NOT_INSTALLED)
    interrupt_on_end_signals()
    to_stdout = str(output) == STDIN
    if not to_stdout:
        check_output_path(output, force)
    reading = CaptureReader(words=words, **source)
    report_data = _read_report_data(reading, wanted)
    reading.print_summary()
    if report_data is None:
        exit_with(words("report.no-bcap"), reading.exit_code or ExitCode.NO_DATA)
    names, remarks = _capture_names(reading.captures.paths, words), _remarks(reading, wanted, words)
    page = report_page(report_data, names, __version__, remarks, reading.citing_words()).encode()
    if to_stdout:
        reading.print_lines([page.removesuffix(b"\n")])
    else:
        with AtomicFile(output) as file:
            file.write(page)
            file.commit(overwrite=force)
    sys.exit(reading.exit_code)


def _read_report_data(reader: CaptureReader, wanted: Filter | None) -> ReportData | None:
    builder = ReportDataBuilder(reader.call_test(wanted))
    reader.read_to_end(builder.diagnosis, builder)
    return builder.report_data(reader.ended_at)


def _capture_names(paths: Sequence[str], words: MessageFormatter) -> list[str]:
    """Return the names of the captures without folders, because a path can reveal private data."""
    return [words("reading.stdin") if path == STDIN else Path(path).name for path in paths]


def _remarks(reader: CaptureReader, wanted: Filter | None, words: MessageFormatter) -> list[str]:
    remarks = []
    if wanted is not None:
        remarks.append(words("report.filtered", filter=wanted.expression))
    if reader.exit_code is not ExitCode.OK:
        remarks.append(words("report.incomplete"))
    return remarks
