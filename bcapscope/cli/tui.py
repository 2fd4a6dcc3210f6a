"""``bcapscope tui``: the screen."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import click
from click.core import ParameterSource

from bcapscope.cli.common import options
from bcapscope.cli.common.data_output import require_terminal
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.proxy_rule_options import RuleOptions, rule_options
from bcapscope.cli.common.serve_options import ServeOptions, serve_options, serve_screen
from bcapscope.cli.common.tui_sources import ProxyScreenOptions, show_proxy, show_simulator
from bcapscope.live.standard_streams import print_stderr
from bcapscope.render.escape import printable

_SUFFIXES = (".pcap", ".pcapng", ".cap", ".txt", ".gz")
"""Endings that no host has; a name that has one is meant to be a file."""


class TesterTarget(NamedTuple):
    """The controller that is to be tested, as `tui.screens.tester_screen.TesterOptions` has it."""

    host: str
    port: int
    tcp: bool
    option: str
    profile: str


@click.command(short_help="The screen: a tester for controllers, and traffic frame by frame.")
@click.argument("path", metavar="[HOST|FILE]", required=False, type=click.Path())
@options.interface
@options.ports
@click.option(
    "--proxy",
    is_flag=False,
    flag_value="",
    metavar="[ADDRESS]",
    help="Show a proxy: one of its own, with --listen, --to and rules as `bcapscope proxy` has them, or the "
    "one that was started with `--control ADDRESS`.",
)
@click.option("--listen", metavar="HOST:PORT", multiple=True, help="Of the proxy, see `bcapscope proxy`.")
@click.option("--to", metavar="HOST:PORT", multiple=True, help="Of the proxy: the controller.")
@click.option(
    "--record",
    metavar="FILE.pcapng",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Of the proxy: keep what passes.",
)
@click.option(
    "--sim", is_flag=True, help="Start a simulator on loopback, port 5007 or -p, and show what it is asked."
)
@click.option("--scenario", metavar="NAME|FILE.yaml", help="Of that simulator; `bcapscope sim --scenarios`.")
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
@serve_options
@rule_options
@click.pass_context
def command(
    context: click.Context,
    *,
    path: str | None,
    interface: str | None,
    ports: tuple[int, ...],
    tcp: bool,
    option: str,
    profile: str,
    requests: Path | None,
    proxy: str | None,
    listen: tuple[str, ...],
    to: tuple[str, ...],
    record: Path | None,
    sim: bool,
    scenario: str | None,
    rules: RuleOptions,
    serve: ServeOptions,
) -> None:
    """Test a controller, or show a capture, or what passes on an interface, a proxy, a simulator.

    With HOST, the Tester: connect, execute, robots, variables, tasks, slave mode, every byte. With no host it
    talks to a built-in simulator. With a FILE or -i: frames, calls, findings, slave mode, statistics.
    With --proxy the same of what passes, and on a second screen clients, rules and held messages; with --sim
    of what a simulator is asked.

    F1 tells the keys, Ctrl-P lists all that can be done, F12 halts the robot, Ctrl-Q ends. Labels are in
    English or Japanese (LANG).

    Exit codes: 0 it was ended; 2 invalid command line; 4 the capture cannot be opened, an address
    not be listened on, or no proxy be found; 6 there is no room for a recording or a journal; 9 there is no
    controller of that name.
    """
    if sum((bool(path), bool(interface), proxy is not None, sim)) > 1:
        raise click.UsageError("name a host or a capture, or one of -i, --proxy and --sim")
    if proxy is None and (listen or to or record or rules.command_line or rules.control):
        raise click.UsageError("--listen, --to, --record and rules are those of a proxy: add --proxy")
    if scenario is not None and not sim:
        raise click.UsageError("--scenario is that of a simulator: add --sim")
    if serve.is_wanted:
        serve_screen(serve)
    if proxy is not None:
        with _exit_without_folder():
            show_proxy(ProxyScreenOptions(proxy, listen, to, record, rules))
        return
    if sim:
        typed = context.get_parameter_source("profile") is ParameterSource.COMMANDLINE
        words = ["--profile", profile] if typed else []
        words += ["--scenario", scenario] if scenario else []
        with _exit_without_folder():
            show_simulator(_server_port(ports), words)
        return
    is_file = bool(path) and Path(path or "").exists()
    if path and not is_file and (os.sep in path or Path(path).suffix in _SUFFIXES):
        print_stderr(f"{printable(path)}: no such file")
        sys.exit(ExitCode.UNREADABLE)
    with _exit_without_folder():
        if is_file or interface:
            _show_traffic(path or "", interface or "", ports)
        else:
            _show_tester(TesterTarget(path or "", _server_port(ports), tcp, option, profile), requests)


def _server_port(ports: tuple[int, ...]) -> int:
    """Return the port that was given, or else that of b-CAP."""
    from bcapscope.client.retry_policies import (
        DEFAULT_PORT,  # with all of the client, which a capture is shown without
    )

    return ports[0] if ports else DEFAULT_PORT


@contextmanager
def _exit_without_folder() -> Iterator[None]:
    """End the program where there is no room for what the screen keeps as long as it is there."""
    from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolderError

    try:
        yield
    except TemporaryFolderError as error:
        print_stderr(printable(str(error)))
        sys.exit(ExitCode.UNWRITABLE)


def _show_tester(wanted: TesterTarget, requests: Path | None) -> None:
    from bcapscope.client.action_log import default_folder
    from bcapscope.tui.app import BcapApp, ScreenEntry
    from bcapscope.tui.controller_access import saved_requests
    from bcapscope.tui.screens.tester_screen import TesterOptions, TesterScreen
    from bcapscope.tui.screens.traffic_screen import TrafficScreen
    from bcapscope.tui.traffic_processes.client_recording import ClientRecording
    from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolder
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed

    with TemporaryFolder() as folder:
        own = folder.path / "own.pcapng"
        tap = ClientRecording(own)
        start = TesterOptions(
            requests or saved_requests.default_requests_folder(),
            default_folder(),
            *wanted,
            tap.write_observation,
        )
        tester = ScreenEntry("tester", "f2", "tester.name.screen", lambda: TesterScreen(start))
        traffic = ScreenEntry(
            "traffic",
            "f3",
            "traffic",
            lambda: TrafficScreen(TrafficFeed(path=str(own), follow=True, own_clients=True), wanted.host),
        )
        try:
            require_terminal()
            try:
                BcapApp([tester, traffic]).run_until_closed()
            finally:
                print_stderr(f"The action log is in {start.log_folder}.")
        finally:
            tap.close()


def _show_traffic(path: str, interface: str, ports: tuple[int, ...]) -> None:
    # Reading begins before the screen is even loaded, in a process of its own.
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed

    feed = TrafficFeed(path=path, interface=interface, ports=ports)
    try:
        from bcapscope.tui.app import BcapApp, ScreenEntry
        from bcapscope.tui.screens.traffic_screen import TrafficScreen

        require_terminal()
        title = Path(path).name or interface
        BcapApp(
            [ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, title))]
        ).run_until_closed()
    finally:
        feed.close()
