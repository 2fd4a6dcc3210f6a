"""``bcapscope report``: one page about captures, to read in a browser and to mail."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from bcapscope import __version__
from bcapscope.analysis.report_data import ReportData, ReportDataBuilder
from bcapscope.cli.common import options
from bcapscope.cli.common.call_reading import read_to_end
from bcapscope.cli.common.capture_reader import STDIN, CaptureReader
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.output_files import AtomicFile, check_output_path, force_option
from bcapscope.live.end_signals import interrupt_on_end_signals
from bcapscope.live.standard_streams import print_stderr
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS

_INSTALL = "a report needs plotly, which is not installed: pip install 'bcapscope[report]'"


@click.command(short_help="Write a page with findings, figures and pictures, to mail.")
@options.captures
@options.output_option("Where to, such as report.html; - is standard output.", allow_dash=True)
@options.ports
@options.filter_option(RecordKind.CALL)
@force_option
def command(
    *, paths: tuple[str, ...], output: Path, ports: tuple[int, ...], wanted: Filter | None, force: bool
) -> None:
    """Write what captures hold as one HTML page that needs no network and no other file.

    It has a summary, the findings of diagnose, a timeline, the pace of slave mode, how long calls took, and
    what was sent again, in words, tables and pictures. It takes plotly: pip install 'bcapscope[report]'.
    A filter chooses calls, as it does for stats, slave and diagnose; the page says so.

    Exit codes: 0 the page was written; 2 invalid command line; 3 a capture is damaged or breaks
    off, all before the damage is in the page; 4 nothing could be read; 5 there was no b-CAP, so there is no
    page; 6 the page could not be written; 7 plotly is not installed.
    """
    try:
        from bcapscope.render.report_page import report_page
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "plotly":
            raise
        print_stderr(_INSTALL)
        sys.exit(ExitCode.NOT_INSTALLED)
    interrupt_on_end_signals()
    to_stdout = str(output) == STDIN
    if not to_stdout:
        check_output_path(output, force)
    reading = CaptureReader(paths, ports)
    account = _read_report_data(reading, wanted)
    reading.print_summary()
    if account is None:
        print_stderr("no b-CAP was seen, so there is no report")
        sys.exit(reading.exit_code or ExitCode.NO_DATA)
    page = report_page(account, _capture_names(paths), __version__, _remarks(reading, wanted)).encode("utf-8")
    if to_stdout:
        reading.output.write_lines([page.removesuffix(b"\n")], reading.show_progress)
    else:
        with AtomicFile(output) as file:
            file.write(page)
            file.commit(overwrite=force)
    sys.exit(reading.exit_code)


def _read_report_data(reader: CaptureReader, wanted: Filter | None) -> ReportData | None:
    accountant = ReportDataBuilder(None if wanted is None else wanted.bind(CALL_GETTERS))
    read_to_end(reader, accountant.on_observation, accountant.on_pairing_result)
    return accountant.finish(reader.ended_at)


def _capture_names(paths: Sequence[str]) -> list[str]:
    """Name the captures without their folders, which are nobody's business but the user's."""
    return ["standard input" if path == STDIN else Path(path).name for path in paths]


def _remarks(reader: CaptureReader, wanted: Filter | None) -> list[str]:
    remarks = []
    if wanted is not None:
        remarks.append(f"Only calls that fit this filter are told: {wanted.expression}")
    if reader.exit_code is not ExitCode.OK:
        told = "this page tells what stands before the damage"
        remarks.append(f"Not all captures could be read to their end; {told}.")
    return remarks
