"""Options that say how to reach a controller, for all commands that talk to one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import wraps
from typing import Any

import click
from click.core import ParameterSource

from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate
from bcapscope.client.paces import PACES, PORT
from bcapscope.client.target import Target, reason_of, split_port
from bcapscope.errors import BcapError, ControllerError, ExchangeTimeout
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.numerals import read_integer
from bcapscope.protocol.wording import shortened
from bcapscope.render.escape import printable

__all__ = ["Target", "failures_told", "target"]

_MS = 1_000_000
_ON_UDP = (Convention.SEED, Convention.OWN, Convention.CHAIN)
_ON_TCP = (Convention.TCP0, Convention.TCP1)


def _convention(context: click.Context, _: click.Parameter, value: str | None) -> Convention | None:
    if value is None:
        return None
    convention = Convention(value)
    if convention not in (_ON_TCP if context.params.get("tcp") else _ON_UDP):
        raise click.BadParameter(f"{value} is not for {'TCP' if context.params.get('tcp') else 'UDP'}")
    return convention


def _some_host(context: click.Context, _: click.Parameter, value: str) -> str:
    if not value:
        raise click.BadParameter("it is empty")
    return value


_OPTIONS = (
    click.option("-p", "--port", type=options.Whole(1, 65535), default=PORT, show_default=True),
    click.option("--tcp/--udp", "tcp", is_eager=True, help="What to talk over; UDP unless given."),
    click.option(
        "--timeout",
        metavar="MS",
        type=options.Number(0.1),
        default=PACES.others.timeout / _MS,
        show_default=True,
        help="How long to wait for each try, slvMove apart, which has DENSO's 2 ms.",
    ),
    click.option(
        "--retries",
        type=options.Whole(0, 100),
        default=PACES.others.retries,
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


def target(function: Callable[..., None]) -> Callable[..., None]:
    """Add the argument HOST and the options; the command is given a `target`."""
    return click.argument("host", callback=_some_host)(_with_target(function))


def optional_target(function: Callable[..., None]) -> Callable[..., None]:
    """Add the same for a command that can do without a controller; its host is empty then."""
    return click.argument("host", required=False, default="")(_with_target(function))


def _with_target(function: Callable[..., None]) -> Callable[..., None]:
    @wraps(function)
    def with_target(**given: Any) -> None:
        own = {field.name: given.pop(field.name) for field in fields(Target)}
        own["host"], own["port"] = _place(own["host"], own["port"])
        function(target=Target(**own), **given)

    decorated: Callable[..., None] = with_target
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    return decorated


def _place(text: str, port: int) -> tuple[str, int]:
    """Return host and port; a port behind the host counts, as in ``192.168.0.1:5007`` or ``[::1]:5007``.

    Raises:
        click.BadParameter: no host or port has this form.
    """
    host, behind = split_port(text)
    if text and not _can_be_asked_for(host):
        raise click.BadParameter(f"{printable(shortened(text, 80))} is no host", param_hint="HOST")
    if not behind:
        return host, port
    behind_host = read_integer(behind, 1, 65535)
    if behind_host is None:
        raise click.BadParameter(
            f"{printable(shortened(behind, 40))} is not a port from 1 to 65535", param_hint="HOST"
        )
    given = click.get_current_context().get_parameter_source("port")
    if given is ParameterSource.COMMANDLINE and behind_host != port:
        raise click.UsageError(f"{printable(text)} and --port {port} exclude each other")
    return host, behind_host


def _can_be_asked_for(host: str) -> bool:
    try:
        return bool(host.encode("idna"))  # as the system's resolver is asked
    except UnicodeError:
        return False


@contextmanager
def failures_told(target: Target) -> Iterator[None]:
    """Turn what goes wrong between us and a controller into a sentence and an exit code."""
    try:
        yield
    except BrokenPipeError:
        raise
    except ControllerError as error:
        _end(str(error), Exit.REFUSED)
    except ExchangeTimeout as error:
        _end(f"{target}: {error}", Exit.UNANSWERED)
    except OSError as error:
        _end(f"{target}: {reason_of(error)}", Exit.UNANSWERED)
    except BcapError as error:
        _end(str(error), Exit.USAGE)


def _end(text: str, code: Exit) -> None:
    narrate(f"bcapscope: {text}")
    raise SystemExit(code)
