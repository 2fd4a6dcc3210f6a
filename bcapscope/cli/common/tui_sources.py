"""Proxies and simulators as sources of traffic for ``bcapscope tui``."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from bcapscope.cli.common.data_output import require_terminal
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.cli.common.output_files import check_output_path
from bcapscope.cli.common.proxy_rule_options import RuleOptions
from bcapscope.live.standard_streams import print_stderr
from bcapscope.messages import MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.traffic.joining.twin_recognition import CLIENT_LEG

if TYPE_CHECKING:
    from bcapscope.live.child_process import ChildProcess
    from bcapscope.proxy.control_messages import ProxyStats
    from bcapscope.tui.app import ScreenEntry
    from bcapscope.tui.screens.proxy_screen import ProxyScreen
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed


def choose_language(context: click.Context, words: MessageFormatter) -> None:
    """Set the language of the screen and of its processes: that of --lang, or that of the settings."""
    from bcapscope.tui.reader_language import set_language
    from bcapscope.tui.settings import default_settings_path, read_settings

    if context.get_parameter_source("words") is ParameterSource.COMMANDLINE:
        set_language(words.language)
    else:
        set_language(read_settings(default_settings_path())[0].language)


def run_app(*screens: ScreenEntry) -> None:
    """Run the app with these screens until the user quits."""
    from bcapscope.tui.app import BcapApp

    require_terminal()
    BcapApp(list(screens)).run_until_closed()


def show_proxy(
    address: str, listen: Sequence[str], to: Sequence[str], record: Path | None, rules: RuleOptions
) -> None:
    """Show the running proxy with this control socket. If the address is "", start a new proxy and show its
    traffic.
    """
    if not address:
        _show_own_proxy(listen, to, record, rules)
    elif listen or to or record or rules.command_line or rules.control:
        raise click.UsageError(
            f"the proxy on {address} runs already: leave out --listen, --to, --record and rules"
        )
    else:
        _show_running_proxy(address)


def _show_running_proxy(address: str) -> None:
    from bcapscope.tui.reader_language import label
    from bcapscope.tui.traffic_processes.process_messages import ReadJob
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed

    figures = _read_figures(address)
    if figures.recording is None:
        _show_screens(None, _proxy_screen(address, figures, None, note=label("proxy.unrecorded")))
        return
    feed = TrafficFeed(ReadJob(path=figures.recording, follow=True, ports=figures.ports, leg=CLIENT_LEG))
    with closing(feed):
        _show_screens(feed, _proxy_screen(address, figures, feed))


def _show_own_proxy(
    listen: Sequence[str], to: Sequence[str], record: Path | None, rules: RuleOptions
) -> None:
    import msgspec

    from bcapscope.proxy.listener_spec import ListenerSpecError, parse_listener_specs

    try:
        parse_listener_specs(listen, to)
    except ListenerSpecError as error:
        raise click.UsageError(str(error)) from None
    if record is not None:
        check_output_path(record)
    from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolder
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed, watcher_job

    with TemporaryFolder() as folder:
        record = record or folder.path / "proxy.pcapng"
        control = rules.control or _control_address(folder.path)
        words = [word for each in listen for word in ("--listen", each)]
        words += [word for each in to for word in ("--to", each)]
        words += ["--record", str(record), "--control", control, "--quiet", *rules.command_line]
        job = watcher_job(folder.path, record)
        words += ["--publish", msgspec.json.encode(job).decode()]
        with _running_command("proxy", *words) as child:
            figures = _read_figures(child.control_address)
            with closing(TrafficFeed(job, child.hand_over_stdout())) as feed:
                _show_screens(feed, _proxy_screen(child.control_address, figures, feed, child))


def show_simulator(port: int, words: Sequence[str]) -> None:
    """Start a simulator on loopback and show its traffic. `words` are further options of `sim`."""
    from bcapscope.tui.app import ScreenEntry
    from bcapscope.tui.screens.traffic_screen import SimulatorScreen
    from bcapscope.tui.traffic_processes.process_messages import ReadJob
    from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolder
    from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed

    with TemporaryFolder() as folder:
        record = str(folder.path / "simulator.pcapng")
        own = ("--port", f"{port}", "--record", record, "--quiet")
        with _running_command("sim", *own, *words) as child:
            (address,) = child.listen_addresses
            job = ReadJob(path=record, follow=True, ports=(int(address.rpartition(":")[2]),))
            with closing(TrafficFeed(job)) as feed:
                screen = partial(SimulatorScreen, feed, address, child)
                run_app(ScreenEntry("traffic", "f3", "traffic", screen))


def _proxy_screen(
    address: str,
    figures: ProxyStats,
    feed: TrafficFeed | None,
    child: ChildProcess | None = None,
    note: str = "",
) -> ProxyScreen:
    from bcapscope.tui.screens.proxy_screen import ProxyScreen

    return ProxyScreen(address, ", ".join(figures.listening), feed, child, note)


def _show_screens(feed: TrafficFeed | None, screen: ProxyScreen) -> None:
    from bcapscope.tui.app import ScreenEntry
    from bcapscope.tui.screens.traffic_screen import TrafficScreen

    screens = [ScreenEntry("proxy", "f2", "proxy", lambda: screen)]
    if feed is not None:
        screens.append(ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, screen.route)))
    run_app(*screens)


def _read_figures(address: str) -> ProxyStats:
    """Return the figures of the proxy at this address. If no proxy answers, exit."""
    from bcapscope.errors import BcapError
    from bcapscope.proxy.control_client import ControlClient
    from bcapscope.proxy.control_messages import GetStats, ProxyStats
    from bcapscope.tui.reader_language import full_error_text

    try:
        with closing(ControlClient(address)) as client:
            return client.request(GetStats(), ProxyStats)
    except BcapError as error:
        exit_with(printable(full_error_text(error)), ExitCode.UNREADABLE)


@contextmanager
def _running_command(*words: str) -> Iterator[ChildProcess]:
    """Run a bcapscope command as a child process during the block. Then print the rest of its output."""
    from bcapscope.live.child_process import ChildProcess, ChildStartError
    from bcapscope.tui.reader_language import current_language, full_error_text

    try:
        child = ChildProcess(*words, "--lang", current_language())
    except ChildStartError as error:
        exit_with(printable(full_error_text(error)), error.code)
    try:
        yield child
    finally:
        output = child.terminate()
        with suppress(OSError):  # the terminal may be closed
            for line in output:
                print_stderr(printable(line))


def _control_address(folder: Path) -> str:
    """Return an address for the control socket: if possible a Unix socket, which other users cannot open."""
    import socket

    path = str(folder / "control")
    # The limit is in bytes. The path of a socket has at most 103 bytes on macOS, and 107 bytes on Linux.
    longest = 100
    if not hasattr(socket, "AF_UNIX"):
        return "127.0.0.1:0"
    if len(os.fsencode(path)) <= longest:
        return path
    return os.path.join(tempfile.gettempdir(), f"bcapscope-{os.getpid()}-{folder.name[-8:]}")
