"""``bcapscope tui``: the screen."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate
from bcapscope.client.paces import PORT
from bcapscope.render.escape import printable

if TYPE_CHECKING:
    from bcapscope.tui.traffic.feed import Feed


_SUFFIXES = (".pcap", ".pcapng", ".cap", ".txt", ".gz")
"""Endings that no host has; a name that has one is meant to be a file."""


class Wanted(NamedTuple):
    """The controller that is to be tested, as `tui.screens.tester.Start` has it."""

    host: str
    port: int
    tcp: bool
    option: str
    profile: str


@click.command(short_help="The screen: a tester for controllers, and traffic frame by frame.")
@click.argument("path", metavar="[HOST|FILE]", required=False, type=click.Path())
@options.interface
@options.ports
@click.option("--tcp/--udp", "tcp", help="What to talk to a controller over; UDP unless given.")
@click.option("--option", metavar="TEXT", default="", help="Of the connection, as in the field: Timeout=300.")
@click.option(
    "--profile",
    type=click.Choice(["rc7", "rc8", "rc9", "cserver"]),
    default="rc7",
    show_default=True,
    help="What the built-in simulator is.",
)
@click.option(
    "--requests", metavar="FOLDER", type=click.Path(path_type=Path), help="Where saved requests are kept."
)
def command(
    *,
    path: str | None,
    interface: str | None,
    ports: tuple[int, ...],
    tcp: bool,
    option: str,
    profile: str,
    requests: Path | None,
) -> None:
    """Test a controller, or show a capture, or what passes on an interface.

    With HOST, the Tester: connect, execute, robots, variables, tasks, slave mode, every byte. With no host it
    talks to a built-in simulator. With a FILE or -i: frames, calls, findings, slave mode, statistics.

    F1 tells the keys, Ctrl-P lists all that can be done, F12 halts the robot, Ctrl-Q ends. Labels are in
    English or Japanese (LANG).

    Exit codes: 0 it was ended; 2 the command line makes no sense; 4 the capture cannot be opened.
    """
    if path and interface:
        raise click.UsageError("name a host or a capture, or an interface with -i")
    is_file = bool(path) and Path(path or "").exists()
    if path and not is_file and (os.sep in path or Path(path).suffix in _SUFFIXES):
        narrate(f"{printable(path)}: no such file")
        sys.exit(Exit.UNREADABLE)
    if not is_file and not interface:
        _test(Wanted(path or "", ports[0] if ports else PORT, tcp, option, profile), requests)
        return
    # Reading begins before the screen is even loaded, in a process of its own.
    from bcapscope.tui.traffic.feed import Feed

    feed = Feed(path=path or "", interface=interface or "", ports=ports)
    try:
        _show(feed, Path(path).name if path else interface or "")
    finally:
        feed.close()


def _test(wanted: Wanted, requests: Path | None) -> None:
    from bcapscope.tui.app import Scope, Spot
    from bcapscope.tui.desk import audit, saved
    from bcapscope.tui.screens.tester import Start, Tester

    start = Start(requests or saved.default_folder(), audit.default_folder(), *wanted)
    Scope([Spot("tester", "f2", "tester.name.screen", lambda: Tester(start))]).run()
    narrate(f"what was sent is written down in {start.audit}")


def _show(feed: Feed, title: str) -> None:
    from bcapscope.tui.app import Scope, Spot
    from bcapscope.tui.screens.traffic import TrafficScreen

    Scope([Spot("traffic", "f3", "traffic", lambda: TrafficScreen(feed, title))]).run()
