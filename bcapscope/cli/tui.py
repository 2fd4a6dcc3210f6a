"""``bcapscope tui``: the screen."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate
from bcapscope.render.escape import printable

if TYPE_CHECKING:
    from bcapscope.tui.traffic.feed import Feed


@click.command(short_help="The screen: traffic as it is, frame by frame.")
@click.argument("path", metavar="[PATH]", required=False, type=click.Path())
@options.interface
@options.ports
def command(*, path: str | None, interface: str | None, ports: tuple[int, ...]) -> None:
    """Show a capture, or what passes on an interface: frames, calls, findings, slave mode, statistics.

    F1 tells the keys, Ctrl-P lists all that can be done, Ctrl-Q ends. Labels are in English or Japanese
    (LANG).

    Exit codes: 0 it was ended; 2 the command line makes no sense; 4 the capture cannot be opened.
    """
    if bool(path) == bool(interface):
        raise click.UsageError("name a capture, or an interface with -i")
    if path and not Path(path).is_file():
        narrate(f"{printable(path)}: no such file")
        sys.exit(Exit.UNREADABLE)
    # Reading begins before the screen is even loaded, in a process of its own.
    from bcapscope.tui.traffic.feed import Feed

    feed = Feed(path=path or "", interface=interface or "", ports=ports)
    try:
        _show(feed, Path(path).name if path else interface or "")
    finally:
        feed.close()


def _show(feed: Feed, title: str) -> None:
    from bcapscope.tui.app import Scope, Spot
    from bcapscope.tui.screens.traffic import TrafficScreen

    Scope([Spot("traffic", "f3", "traffic", lambda: TrafficScreen(feed, title))]).run()
