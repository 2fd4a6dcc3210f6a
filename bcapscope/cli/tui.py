"""``bcapscope tui``: open the screen."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import click
from click.core import ParameterSource

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.cli.common.proxy_rule_options import RuleOptions, rule_options
from bcapscope.cli.common.serve_options import ServeOptions, run_app, serve_options, serve_screen
from bcapscope.messages import MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.traffic.capture_point import CapturePoint

_SUFFIXES = (".pcap", ".pcapng", ".cap", ".txt", ".gz")
"""An argument with one of these suffixes is a file, not a host name."""


@click.command()
@click.argument("path", metavar="[HOST|FILE]", required=False, type=click.Path())
@options.interface
@options.ports
@options.taken_at
@click.option(
    "--proxy",
    is_flag=False,
    flag_value="",
    metavar="[ADDRESS]",
    help="Show a proxy. Without ADDRESS, start a proxy with --listen, --to and rules, as for "
    "`bcapscope proxy`. With ADDRESS, show the running proxy that was started with `--control ADDRESS`.",
)
@click.option(
    "--listen",
    metavar="HOST:PORT",
    multiple=True,
    help="Let the proxy listen on this address; see `bcapscope proxy`.",
)
@click.option("--to", metavar="HOST:PORT", multiple=True, help="Let the proxy forward to this controller.")
@options.record_option("Let the proxy record the traffic to a new capture.")
@click.option(
    "--sim", is_flag=True, help="Start a simulator on 127.0.0.1, port 5007 or -p, and show its traffic."
)
@click.option(
    "--scenario",
    metavar="NAME|FILE.yaml",
    help="Play this scenario in the simulator; `bcapscope sim --scenarios` lists all.",
)
@click.option("--tcp/--udp", "tcp", help="Connect to the controller over TCP or UDP.")
@click.option(
    "--option", metavar="TEXT", default="", help="Connect with this option string, such as Timeout=300."
)
@click.option(
    "--profile",
    type=click.Choice(["rc7", "rc8", "rc9", "cserver"]),
    help="Kind of controller that the simulator imitates, with --sim or without a HOST. Default: as for "
    "`bcapscope sim`.",
)
@click.option(
    "--requests",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Keep saved requests in this folder. Default: a folder of bcapscope in your user data.",
)
@options.language
@serve_options
@rule_options
@click.pass_context
def command(
    context: click.Context,
    *,
    path: str | None,
    interface: str | None,
    ports: tuple[int, ...],
    taken_at: CapturePoint | None,
    tcp: bool,
    option: str,
    profile: str | None,
    requests: Path | None,
    proxy: str | None,
    listen: tuple[str, ...],
    to: tuple[str, ...],
    record: Path | None,
    sim: bool,
    scenario: str | None,
    rules: RuleOptions,
    serve: ServeOptions,
    words: MessageFormatter,
) -> None:
    """Open the screen: test a controller, or show the traffic of a capture, interface, proxy or simulator.

    With HOST, the screen opens the Tester, in which you connect, execute functions and see every byte. -p is
    then the port of the controller. Without arguments, the Tester connects to a built-in simulator.

    With FILE or -i, the screen shows frames, calls, findings, slave mode and statistics. --proxy shows the
    traffic of a proxy. A second screen shows the proxy's clients, rules and held messages. --sim shows the
    traffic of a simulator.

    Keys: F1 shows all keys, Ctrl-P finds actions by name, F12 halts the robot, Ctrl-Q quits. The screen is in
    English or Japanese. --lang chooses the language; without --lang, the language in your settings is used.

    Exit codes: 0: you closed the screen; 2: invalid command line; 4: the capture cannot be opened, an address
    cannot be used for listening, or no proxy was found; 6: a recording or temporary file cannot be written;
    9: the name of the controller is unknown.
    """
    is_file = bool(path) and Path(path or "").exists()
    if sum((bool(path), bool(interface), proxy is not None, sim)) > 1:
        raise click.UsageError("give only one of HOST, FILE, -i, --proxy and --sim")
    _check_source_options(scenario, taken_at, is_simulator=sim, is_capture=is_file or bool(interface))
    if proxy is None and (listen or to or record or rules.command_line or rules.control):
        raise click.UsageError("--listen, --to, --record and rules need --proxy: add --proxy")
    if serve.is_wanted:
        serve_screen(serve)
    _choose_language(context, words)
    if path and not is_file and (os.sep in path or Path(path).suffix in _SUFFIXES):
        exit_with(words("tui.no-file", path=printable(path)), ExitCode.UNREADABLE)
    with _exit_without_folder():
        if is_file or interface:
            _show_traffic(path or "", interface or "", ports, taken_at)
            return
        from bcapscope.cli.common.tui_sources import show_proxy, show_simulator, show_tester

        if proxy is not None:
            show_proxy(proxy, listen, to, record, rules)
        elif sim:
            show_simulator(ports, profile, scenario)
        else:
            show_tester(requests, path or "", ports, tcp=tcp, option=option, profile=profile)


def _check_source_options(
    scenario: str | None, taken_at: CapturePoint | None, *, is_simulator: bool, is_capture: bool
) -> None:
    if scenario is not None and not is_simulator:
        raise click.UsageError("--scenario has no effect without --sim: add --sim")
    if taken_at is not None and not is_capture:
        raise click.UsageError("--taken-at needs a capture: give FILE or -i")


def _choose_language(context: click.Context, words: MessageFormatter) -> None:
    """Set the language of the screen and its processes. --lang takes precedence over the settings."""
    from bcapscope.tui.reader_language import set_language
    from bcapscope.tui.settings import default_settings_path, read_settings

    if context.get_parameter_source("words") is ParameterSource.COMMANDLINE:
        set_language(words.language)
    else:
        set_language(read_settings(default_settings_path())[0].language)


@contextmanager
def _exit_without_folder() -> Iterator[None]:
    from bcapscope.tui.reader_language import full_error_text
    from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolderError

    try:
        yield
    except TemporaryFolderError as error:
        exit_with(printable(full_error_text(error)), ExitCode.UNWRITABLE)


def _show_traffic(path: str, interface: str, ports: tuple[int, ...], taken_at: CapturePoint | None) -> None:
    # `TrafficFeed` starts a separate process, which reads the traffic while this process loads the screen.
    from bcapscope.tui.traffic_processes.process_messages import ReadJob
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed

    job = ReadJob(path=path, interface=interface, ports=ports, taken_at=taken_at)
    with closing(TrafficFeed(job)) as feed:
        from bcapscope.tui.app import ScreenEntry
        from bcapscope.tui.screens.traffic_screen import TrafficScreen

        title = Path(path).name or interface
        run_app(ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, title)))
