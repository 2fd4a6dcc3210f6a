"""``bcapscope report``: one page about captures, to read in a browser and to mail."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from bcapscope import __version__
from bcapscope.analysis.account import Account, Accountant
from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.files import NewFile, check_free, force
from bcapscope.cli.output import narrate
from bcapscope.cli.pairing import follow
from bcapscope.cli.reading import STDIN, Reading
from bcapscope.cli.signals import end_in_order
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter
from bcapscope.traffic.getters import CALL_GETTERS

_INSTALL = "a report needs plotly, which is not installed: pip install 'bcapscope[report]'"


@click.command(short_help="Write a page with findings, figures and pictures, to mail.")
@options.captures
@options.output_option("Where to, such as report.html; - is standard output.", allow_dash=True)
@options.ports
@options.filter_option(RecordKind.CALL)
@force
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
        narrate(_INSTALL)
        sys.exit(Exit.NOT_INSTALLED)
    end_in_order()
    to_stdout = str(output) == STDIN
    if not to_stdout:
        check_free(output, force)
    reading = Reading(paths, ports)
    account = _account(reading, wanted)
    reading.summary()
    if account is None:
        narrate("no b-CAP was seen, so there is no report")
        sys.exit(reading.exit or Exit.NOTHING)
    page = report_page(account, _names(paths), __version__, _remarks(reading, wanted)).encode("utf-8")
    if to_stdout:
        reading.output.write_lines([page.removesuffix(b"\n")], reading.pause)
    else:
        with NewFile(output) as file:
            file.write(page)
            file.keep(overwrite=force)
    sys.exit(reading.exit)


def _account(reading: Reading, wanted: Filter | None) -> Account | None:
    accountant = Accountant(None if wanted is None else wanted.bind(CALL_GETTERS))
    follow(reading, accountant.take_observation, accountant.take)
    return accountant.finish(reading.ended)


def _names(paths: Sequence[str]) -> list[str]:
    """Name the captures without their folders, which are nobody's business but the user's."""
    return ["standard input" if path == STDIN else Path(path).name for path in paths]


def _remarks(reading: Reading, wanted: Filter | None) -> list[str]:
    remarks = []
    if wanted is not None:
        remarks.append(f"Only calls that fit this filter are told: {wanted.expression}")
    if reading.exit is not Exit.OK:
        told = "this page tells what stands before the damage"
        remarks.append(f"Not all captures could be read to their end; {told}.")
    return remarks
