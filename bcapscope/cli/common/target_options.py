"""Options of all commands that connect to a controller."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import click
from click.core import ParameterSource

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.client.controller_target import (
    DEFAULT_PORT,
    DEFAULT_RETRIES,
    DEFAULT_TIMEOUT_MS,
    ControllerTarget,
    split_host_port,
)
from bcapscope.errors import BcapError, CallTimeout, ControllerError, FileWriteError
from bcapscope.messages import MessageFormatter
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions
from bcapscope.protocol.text_format import shortened
from bcapscope.render.escape import printable

__all__ = ["ControllerTarget", "exit_on_failure", "target_options"]


def _convention(context: click.Context, _: click.Parameter, value: str | None) -> ReservedConvention | None:
    if value is None:
        return None
    convention = ReservedConvention(value)
    tcp = bool(context.params.get("tcp"))
    if convention not in client_conventions(not tcp):
        raise click.BadParameter(f"{value} does not exist on {'TCP' if tcp else 'UDP'}")
    return convention


def _nonempty_host(context: click.Context, _: click.Parameter, value: str) -> str:
    if not value:
        raise click.BadParameter("the host is empty; give a name or an IP address")
    return value


_OPTIONS = (
    click.option("--tcp/--udp", "tcp", is_eager=True, help="Connect over TCP or UDP."),
    click.option(
        "--timeout",
        metavar="MS",
        type=options.NumberRange(0.1),
        default=DEFAULT_TIMEOUT_MS,
        help="Wait this long for the reply to each attempt, in ms. slvMove always uses DENSO's 2 ms.",
    ),
    click.option(
        "--retries",
        type=options.IntegerRange(0, 100),
        default=DEFAULT_RETRIES,
        help="Maximum number of retries of a request on UDP. In an Async mode, bcapscope makes 3 retries "
        "instead of 4, as DENSO recommends. On TCP there are no retries: the only attempt waits as long "
        "as all UDP attempts together.",
    ),
    click.option(
        "--convention",
        type=click.Choice([each.value for udp in (True, False) for each in client_conventions(udp)]),
        callback=_convention,
        help="Fill the reserved field of requests by this convention. "
        'On UDP, "seed" writes 0 into the first attempt, and the serial of the first attempt into retries. '
        '"own" writes the serial of the first attempt into all attempts. '
        '"chain" writes 0 into the first attempt, and the serial of the previous attempt into a retry. '
        'On TCP, "tcp0" writes 0, and "tcp1" writes 1. The default is "seed" on UDP and "tcp0" on TCP.',
    ),
    click.option(
        "--service",
        metavar="OPTION",
        default="",
        help="Send this option with Service_Start, such as ,WDT=400.",
    ),
    click.option(
        "--name",
        default="",
        help="Connect under this controller name; if the name is empty, the controller chooses one.",
    ),
    click.option(
        "--provider",
        default="CaoProv.DENSO.VRC",
        help="Connect with this provider. RC9 and COBOTTA PRO need CaoProv.DENSO.VRC9; RC7 accepts "
        "any provider.",
    ),
    click.option("--machine", default="localhost", help="Send this machine name to the provider."),
    click.option(
        "--connect-option", metavar="OPTION", default="", help="Send this option with Controller_Connect."
    ),
)


def _target_options(host: options.Decorator, port_help: str) -> options.Decorator:
    def make_target(**given: Any) -> ControllerTarget:
        given["host"], given["port"] = _host_and_port(given["host"], given["port"])
        return ControllerTarget(**given)

    kind = options.IntegerRange(1, 65535)
    port = click.option("-p", "--port", type=kind, default=DEFAULT_PORT, help=port_help)
    names = (field.name for field in fields(ControllerTarget))
    return options.bundled("target", make_target, (host, port, *_OPTIONS), names)


target_options = _target_options(
    click.argument("host", callback=_nonempty_host), "Connect to this port of the controller."
)
"""Adds HOST and the connection options. The command gets their values as one argument, `target`."""

optional_target_options = _target_options(
    click.argument("host", required=False, default=""),
    "Connect to this port of the controller; with --as server, listen on this port.",
)
"""Like `target_options`, but users may leave out HOST; `target.host` is then empty."""


def _host_and_port(text: str, port: int) -> tuple[str, int]:
    """Split a text such as ``192.168.0.1:5007`` or ``[::1]:5007``. `port` is the value of --port."""
    host, behind = split_host_port(text)
    if text and not _can_be_resolved(host):
        reason = f"{printable(shortened(text, 80))} is not a valid host name or address"
        raise click.BadParameter(reason, param_hint="HOST")
    if not behind:
        return host, port
    behind_host = parse_integer(behind, 1, 65535)
    if behind_host is None:
        raise click.BadParameter(
            f"{printable(shortened(behind, 40))} is not a port from 1 to 65535", param_hint="HOST"
        )
    given = click.get_current_context().get_parameter_source("port")
    if given is ParameterSource.COMMANDLINE and behind_host != port:
        raise click.UsageError(
            f"the port in {printable(text)} differs from --port {port}; give only one port"
        )
    return host, behind_host


def _can_be_resolved(host: str) -> bool:
    try:
        # `socket.getaddrinfo` also uses the codec "idna", and raises the same exception
        return bool(host.encode("idna"))
    except UnicodeError:
        return False


@contextmanager
def exit_on_failure(target: ControllerTarget, words: MessageFormatter) -> Iterator[None]:
    name = words.text(target.message)
    try:
        yield
    except (BrokenPipeError, FileWriteError):
        raise
    except ControllerError as error:
        exit_with(f"bcapscope: {words.text(error.message)}", ExitCode.REFUSED)
    except CallTimeout as error:
        exit_with(f"bcapscope: {name}: {words.text(error.message)}", ExitCode.UNANSWERED)
    except OSError as error:
        exit_with(f"bcapscope: {name}: {words.text(os_reason(error))}", ExitCode.UNANSWERED)
    except BcapError as error:
        exit_with(f"bcapscope: {words.text(error.message)}", ExitCode.USAGE)
