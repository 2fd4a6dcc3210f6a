"""What ``bcapscope tui`` shows: the Tester, a proxy or a simulator.

`show_simulator` and `show_proxy` first start other processes, and then import the screens. The processes work
while the screens are imported, which saves 0.1 s at `tui --sim`.
"""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from bcapscope.cli.common.exit_codes import ExitCode, exit_with, usage_error_on
from bcapscope.cli.common.output_files import check_output_path
from bcapscope.cli.common.proxy_rule_options import RuleOptions
from bcapscope.cli.common.serve_options import run_app
from bcapscope.errors import BcapError
from bcapscope.live.child_process import ChildProcess, ChildStartError
from bcapscope.live.standard_streams import print_stderr
from bcapscope.proxy.listener_spec import ListenerSpecError, parse_listener_specs
from bcapscope.render.escape import printable
from bcapscope.traffic.joining.twin_recognition import CLIENT_LEG
from bcapscope.tui.reader_language import current_language, full_error_text, label
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolder
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed, watcher_job

if TYPE_CHECKING:
    from bcapscope.proxy.control_messages import ProxyStats


def show_tester(
    requests: Path | None, host: str, ports: Sequence[int], *, tcp: bool, option: str, profile: str | None
) -> None:
    """Show the Tester. `requests` is the folder of the saved requests; None for the usual folder."""
    from bcapscope.client.action_log import default_folder
    from bcapscope.live.background_recorder import BackgroundRecorder
    from bcapscope.live.recorder import Recorder
    from bcapscope.simulator.profile import DEFAULT_PROFILE
    from bcapscope.tui.app import ScreenEntry
    from bcapscope.tui.controller_access.saved_requests import default_requests_folder
    from bcapscope.tui.screens.tester_screen import TesterOptions, TesterScreen
    from bcapscope.tui.screens.traffic_screen import TrafficScreen

    folder, log_folder = requests or default_requests_folder(), default_folder()
    with closing(TemporaryFolder()) as temporary:
        own = temporary.path / "own.pcapng"
        with closing(BackgroundRecorder(Recorder(own, lambda message: None))) as recorder:
            port, kind = _server_port(ports), profile or DEFAULT_PROFILE
            tap = recorder.on_observation
            start = TesterOptions(folder, log_folder, host, port, tcp, option, kind, tap)
            traffic = partial(TrafficFeed, ReadJob(path=str(own), follow=True, own_clients=True))
            try:
                run_app(
                    ScreenEntry("tester", "f2", "tester.name.screen", lambda: TesterScreen(start)),
                    ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(traffic(), host)),
                )
            finally:
                print_stderr(f"The action log is in {log_folder}.")


def show_proxy(
    address: str, listen: Sequence[str], to: Sequence[str], record: Path | None, rules: RuleOptions
) -> None:
    """Show the running proxy whose control socket is `address`. If `address` is "", start a new proxy."""
    if not address:
        _show_own_proxy(listen, to, record, rules)
    elif listen or to or record or rules.command_line or rules.control:
        raise click.UsageError(
            f"the proxy on {address} runs already: leave out --listen, --to, --record and rules"
        )
    else:
        _show_running_proxy(address)


def _show_running_proxy(address: str) -> None:
    figures = _read_figures(address)
    if figures.recording is None:
        _show_proxy_screens(address, figures, note=label("proxy.unrecorded"))
        return
    feed = TrafficFeed(ReadJob(path=figures.recording, follow=True, ports=figures.ports, leg=CLIENT_LEG))
    with closing(feed):
        _show_proxy_screens(address, figures, feed)


def _show_own_proxy(
    listen: Sequence[str], to: Sequence[str], record: Path | None, rules: RuleOptions
) -> None:
    with usage_error_on(ListenerSpecError):
        parse_listener_specs(listen, to)
    if record is not None:
        check_output_path(record)
    with closing(TemporaryFolder()) as folder:
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
                _show_proxy_screens(child.control_address, figures, feed, child)


def show_simulator(ports: Sequence[int], profile: str | None, scenario: str | None) -> None:
    words = ["--port", f"{_server_port(ports)}", "--quiet"]
    words += ["--profile", profile] if profile else []
    words += ["--scenario", scenario] if scenario else []
    with closing(TemporaryFolder()) as folder:
        record = str(folder.path / "simulator.pcapng")
        with _running_command("sim", "--record", record, *words) as child:
            (address,) = child.listen_addresses
            job = ReadJob(path=record, follow=True, ports=(int(address.rpartition(":")[2]),))
            with closing(TrafficFeed(job)) as feed:
                from bcapscope.tui.app import ScreenEntry
                from bcapscope.tui.screens.traffic_screen import SimulatorScreen

                screen = partial(SimulatorScreen, feed, address, child)
                run_app(ScreenEntry("traffic", "f3", "traffic", screen))


def _server_port(ports: Sequence[int]) -> int:
    from bcapscope.client.controller_target import DEFAULT_PORT

    return ports[0] if ports else DEFAULT_PORT


def _show_proxy_screens(
    address: str,
    figures: ProxyStats,
    feed: TrafficFeed | None = None,
    child: ChildProcess | None = None,
    note: str = "",
) -> None:
    from bcapscope.tui.app import ScreenEntry
    from bcapscope.tui.screens.proxy_screen import ProxyScreen
    from bcapscope.tui.screens.traffic_screen import TrafficScreen

    screen = ProxyScreen(address, ", ".join(figures.listening), feed, child, note)
    screens = [ScreenEntry("proxy", "f2", "proxy", lambda: screen)]
    if feed is not None:
        screens.append(ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, screen.route)))
    run_app(*screens)


def _read_figures(address: str) -> ProxyStats:
    from bcapscope.proxy.control_client import ControlClient
    from bcapscope.proxy.control_messages import GetStats, ProxyStats

    try:
        with closing(ControlClient(address)) as client:
            return client.request(GetStats(), ProxyStats)
    except BcapError as error:
        exit_with(printable(full_error_text(error)), ExitCode.UNREADABLE)


@contextmanager
def _running_command(*words: str) -> Iterator[ChildProcess]:
    """Run a bcapscope command as a child. At the end, terminate the child and print its remaining output."""
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
    path = str(folder / "control")
    # The limit is in bytes. The path of a socket has at most 103 bytes on macOS, and 107 bytes on Linux.
    longest = 100
    if not hasattr(socket, "AF_UNIX"):
        return "127.0.0.1:0"
    if len(os.fsencode(path)) <= longest:
        return path
    return os.path.join(tempfile.gettempdir(), f"bcapscope-{os.getpid()}-{folder.name[-8:]}")
