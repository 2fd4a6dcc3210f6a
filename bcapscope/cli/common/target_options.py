"""Options that say how to reach a controller, for all commands that talk to one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import wraps
from typing import Any

import click
from click.core import ParameterSource

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.client.controller_target import ControllerTarget, os_error_text, split_host_port
from bcapscope.client.retry_policies import DEFAULT_PORT, DEFAULT_RETRY_POLICIES
from bcapscope.errors import BcapError, CallTimeout, ControllerError, FileWriteError
from bcapscope.live.standard_streams import print_stderr
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.text_format import shortened
from bcapscope.render.escape import printable

__all__ = ["ControllerTarget", "exit_on_failure", "target_options"]

_MS = 1_000_000
_ON_UDP = (ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN)
_ON_TCP = (ReservedConvention.TCP0, ReservedConvention.TCP1)


def _convention(context: click.Context, _: click.Parameter, value: str | None) -> ReservedConvention | None:
    if value is None:
        return None
    convention = ReservedConvention(value)
    if convention not in (_ON_TCP if context.params.get("tcp") else _ON_UDP):
        raise click.BadParameter(f"{value} is not for {'TCP' if context.params.get('tcp') else 'UDP'}")
    return convention


def _nonempty_host(context: click.Context, _: click.Parameter, value: str) -> str:
    if not value:
        raise click.BadParameter("it is empty")
    return value


_OPTIONS = (
    click.option(
        "-p", "--port", type=options.IntegerRange(1, 65535), default=DEFAULT_PORT, show_default=True
    ),
    click.option("--tcp/--udp", "tcp", is_eager=True, help="What to talk over; UDP unless given."),
    click.option(
        "--timeout",
        metavar="MS",
        type=options.NumberRange(0.1),
        default=DEFAULT_RETRY_POLICIES.others.timeout / _MS,
        show_default=True,
        help="How long to wait for each try, slvMove apart, which has DENSO's 2 ms.",
    ),
    click.option(
        "--retries",
        type=options.IntegerRange(0, 100),
        default=DEFAULT_RETRY_POLICIES.others.retries,
        show_default=True,
        help="Tries after the first, on UDP; 4 are 3 in Async modes, as DENSO recommends; on TCP the time of "
        "all is given to the only one.",
    ),
    click.option(
        "--convention",
        type=click.Choice([convention.value for convention in (*_ON_UDP, *_ON_TCP)]),
        callback=_convention,
        help="What goes into reserved: seed (0, then the first serial), own (the own serial first), chain "
        "(the serial before), tcp0, tcp1.",
    ),
    click.option("--service", metavar="OPTION", default="", help="Of Service_Start, such as ,WDT=400."),
    click.option("--name", default="", help="Of Controller_Connect; empty for an automatic one."),
    click.option(
        "--provider",
        default="CaoProv.DENSO.VRC",
        show_default=True,
        help="Of Controller_Connect; CaoProv.DENSO.VRC9 for RC9 and COBOTTA PRO, RC7 takes any.",
    ),
    click.option("--machine", default="localhost", show_default=True, help="Of Controller_Connect."),
    click.option("--connect-option", metavar="OPTION", default="", help="Of Controller_Connect."),
)


def target_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the argument HOST and the options; the command is given a `target_options`."""
    return click.argument("host", callback=_nonempty_host)(_add_target_options(function))


def optional_target_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the same for a command that can do without a controller; its host is empty then."""
    return click.argument("host", required=False, default="")(_add_target_options(function))


def _add_target_options(function: Callable[..., None]) -> Callable[..., None]:
    @wraps(function)
    def with_target(**given: Any) -> None:
        own = {field.name: given.pop(field.name) for field in fields(ControllerTarget)}
        own["host"], own["port"] = _host_and_port(own["host"], own["port"])
        function(target=ControllerTarget(**own), **given)

    decorated: Callable[..., None] = with_target
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    return decorated


def _host_and_port(text: str, port: int) -> tuple[str, int]:
    """Return host and port; a port behind the host counts, as in ``192.168.0.1:5007`` or ``[::1]:5007``.

    Raises:
        click.BadParameter: no host or port has this form.
    """
    host, behind = split_host_port(text)
    if text and not _can_be_resolved(host):
        raise click.BadParameter(f"{printable(shortened(text, 80))} is no host", param_hint="HOST")
    if not behind:
        return host, port
    behind_host = parse_integer(behind, 1, 65535)
    if behind_host is None:
        raise click.BadParameter(
            f"{printable(shortened(behind, 40))} is not a port from 1 to 65535", param_hint="HOST"
        )
    given = click.get_current_context().get_parameter_source("port")
    if given is ParameterSource.COMMANDLINE and behind_host != port:
        raise click.UsageError(f"{printable(text)} and --port {port} exclude each other")
    return host, behind_host


def _can_be_resolved(host: str) -> bool:
    try:
        return bool(host.encode("idna"))  # as the system's resolver is asked
    except UnicodeError:
        return False


@contextmanager
def exit_on_failure(target: ControllerTarget) -> Iterator[None]:
    """Turn what goes wrong between us and a controller into a sentence and an exit code."""
    try:
        yield
    except (BrokenPipeError, FileWriteError):
        raise
    except ControllerError as error:
        _exit_with(str(error), ExitCode.REFUSED)
    except CallTimeout as error:
        _exit_with(f"{target}: {error}", ExitCode.UNANSWERED)
    except OSError as error:
        _exit_with(f"{target}: {os_error_text(error)}", ExitCode.UNANSWERED)
    except BcapError as error:
        _exit_with(str(error), ExitCode.USAGE)


def _exit_with(text: str, code: ExitCode) -> None:
    print_stderr(f"bcapscope: {text}")
    raise SystemExit(code)
