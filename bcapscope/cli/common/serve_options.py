"""`bcapscope tui --serve`: the screen in a browser, on this machine only."""

from __future__ import annotations

import ipaddress
import os
import socket
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.cli.common.options import IntegerRange, bundled, parsed_by
from bcapscope.errors import MissingExtraError
from bcapscope.live.standard_streams import print_stderr
from bcapscope.traffic.observation import Endpoint

if TYPE_CHECKING:
    from bcapscope.tui.app import ScreenEntry

DEFAULT_ADDRESS = "127.0.0.1:8000"
_MAX_VIEWERS = 16
_DRIVER = "TEXTUAL_DRIVER"  # environment variable that only a bcapscope process for a browser page has


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Options for the screen in a browser. `viewers` is the maximum number of browser pages at a time."""

    is_wanted: bool
    address: Endpoint
    viewers: int


def run_app(*screens: ScreenEntry) -> None:
    """Run the app until the user quits. Raises click.UsageError if there is no terminal and no browser."""
    from bcapscope.tui.app import BcapApp

    streams = (sys.__stdin__, sys.__stderr__)
    if _DRIVER not in os.environ and not all(each is not None and each.isatty() for each in streams):
        raise click.UsageError(
            "the screen needs a terminal. Without a terminal, use decode, calls or diagnose"
        )
    BcapApp(list(screens)).run_until_closed()


def serve_screen(options: ServeOptions) -> None:
    """Serve the screen of the running command to browsers until Ctrl-C, then exit.

    For each browser page, the server starts a new process with the command line of the running command. In
    such a process, this function does nothing, so the process shows the screen.
    """
    if _DRIVER in os.environ:
        return
    try:
        from bcapscope.tui.web.web_server import WebServer
    except ImportError:
        exit_with(str(MissingExtraError("textual-serve", "serve")), ExitCode.NOT_INSTALLED)
    import asyncio

    try:
        family = socket.AF_INET6 if ":" in options.address.host else socket.AF_INET
        listening = socket.create_server(options.address, family=family)
    except OSError as error:
        reason = (os.strerror(error.errno) if error.errno else str(error)).lower()
        exit_with(
            f"cannot listen on {options.address}: {reason}. Choose another port with --serve-at.",
            ExitCode.UNREADABLE,
        )
    server = WebServer([sys.executable, "-m", "bcapscope", *sys.argv[1:]], listening, options.viewers)

    def greet() -> None:
        print_stderr(f"Open {server.gate.entry_url}")
        print_stderr(
            "Anyone who knows this address can do everything that you can do here. Keep it secret. "
            "Press Ctrl-C to end."
        )

    with suppress(KeyboardInterrupt):  # Ctrl-C raises this exception if the event loop cannot handle signals.
        asyncio.run(server.run(greet))
    sys.exit(ExitCode.OK)


def _loopback_address(value: str) -> Endpoint:
    host, _, port = value.rpartition(":")
    host = "127.0.0.1" if host == "localhost" else host.removeprefix("[").removesuffix("]")
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        reason = f"{value} is not an IP address with a port. Give one such as {DEFAULT_ADDRESS}"
        raise ValueError(reason) from None
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and int(port) <= 0xFFFF):
        raise ValueError(
            f"{value} does not end with a port from 0 to 65535. Give an address such as {DEFAULT_ADDRESS}"
        )
    if not address.is_loopback:
        raise ValueError(
            f"{host} is not loopback. The connection is not encrypted, and anyone who opens the page can "
            f"move the robot. From another machine, use a tunnel: ssh -L {port}:127.0.0.1:{port} USER@HOST"
        )
    return Endpoint(str(address), int(port))


_OPTIONS = (
    click.option(
        "--serve",
        is_flag=True,
        help="Show the screen in a browser on this machine. bcapscope prints the address to open.",
    ),
    click.option(
        "--serve-at",
        metavar="HOST:PORT",
        default=DEFAULT_ADDRESS,
        callback=parsed_by(_loopback_address),
        help="Serve at this address, on loopback only.",
    ),
    click.option(
        "--viewers",
        type=IntegerRange(1, _MAX_VIEWERS),
        default=1,
        help="Allow this many browser pages at a time, each with its own screen.",
    ),
)


def _make_serve_options(serve: bool, serve_at: Endpoint, viewers: int) -> ServeOptions:
    source_of = click.get_current_context().get_parameter_source
    if not serve and ParameterSource.COMMANDLINE in map(source_of, ("serve_at", "viewers")):
        raise click.UsageError("--serve-at and --viewers have no effect without --serve: add --serve")
    return ServeOptions(serve, serve_at, viewers)


serve_options = bundled("serve", _make_serve_options, _OPTIONS)
"""Adds the serve options. The command gets the argument `serve` of type `ServeOptions`."""
