"""``bcapscope proxy ctl``: control a running proxy."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Any, TypeVar

import click
import msgspec

from bcapscope.cli.common import options
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.faults.quantities import DurationQuantity
from bcapscope.messages import MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.frame import parse_datagram
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_client import ControlClient, ControlRefused
from bcapscope.proxy.control_socket import ControlError
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.traffic.observation import Observation

R = TypeVar("R", bound=control.DoneResponse)

_INDENTED = re.compile(r"\n(?=  )")
"""Line breaks before the indented lines of an error message. These lines quote a rule and mark the error."""

_NAME = click.argument("name")
_NUMBER = click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))


@click.group("ctl", short_help="Control a running proxy.")
@click.argument("address")
@click.option("--json", "as_json", is_flag=True, help="Print the proxy's answer as JSON.")
@options.language
@click.pass_context
def command(context: click.Context, address: str, as_json: bool, words: MessageFormatter) -> None:
    """Control the running proxy that was started with `--control ADDRESS`.

    Exit codes: 0: done; 2: invalid command line; 4: no proxy listens on ADDRESS; 8: the proxy refused the
    command.
    """
    context.obj = _ControlCommand(address, as_json, words)


@dataclass(frozen=True, slots=True)
class _ControlCommand:
    address: str
    as_json: bool
    words: MessageFormatter

    def request(self, request: control.ControlRequest, kind: type[R]) -> R | None:
        """Return the response; with --json, print it and return None. Exit if the proxy refuses."""
        with closing(ControlClient(self.address)) as proxy:
            try:
                if not self.as_json:
                    return proxy.request(request, kind)
                echo(_json_text(proxy.request_raw(request)))
            except ControlError as error:
                exit_with(printable(self.words.text(error.message)), ExitCode.UNREADABLE)
            except ControlRefused as error:
                if self.as_json:
                    echo(_json_text(error.line))
                    sys.exit(ExitCode.REFUSED)
                lines = _INDENTED.split(self.words.text(error.message))
                exit_with("\n".join(map(printable, lines)), ExitCode.REFUSED)
        return None


def _json_text(line: bytes) -> str:
    text = line.decode("utf-8", "replace").strip()
    return text if text.isprintable() else "".join(map(_json_character, text))


def _json_character(char: str) -> str:
    if char.isprintable():
        return char
    if char in "\t\r\n":  # in valid JSON, a raw tab or line break occurs only between tokens
        return " "
    return "".join(f"\\u{unit:04x}" for unit in memoryview(char.encode("utf-16-le")).cast("H"))


@command.command("rules", short_help="List the faults.")
@click.pass_obj
def _rules(ctl: _ControlCommand) -> None:
    """List the faults, whether they are on, and how often they were injected."""
    response = ctl.request(control.ListFaults(), control.FaultsResponse)
    for rule in response.rules if response else ():
        state, injected = (
            "on " if rule.on else "off",
            ctl.words("control.injected", count=f"{rule.injected:<6}"),
        )
        echo(f"{state}  {printable(rule.name):<16} {injected}  {printable(rule.rule)}")


@command.command("add", short_help="Add a fault.")
@click.argument("rule")
@click.pass_obj
def _add(ctl: _ControlCommand, rule: str) -> None:
    """Add a fault in the notation of `proxy --fault`, and print its name."""
    response = ctl.request(control.AddFault(rule), control.FaultResponse)
    if response:
        echo(printable(response.name))


@command.command("intercept", short_help="Change which messages are held.")
@click.argument("expression", required=False)
@click.option(
    "--hold",
    metavar="TIME",
    callback=options.parsed_by(lambda text: DurationQuantity.read(text).text),
    help="Hold messages at most this long, such as 60s (default: no change); see `proxy --hold`.",
)
@click.pass_obj
def _intercept(ctl: _ControlCommand, expression: str | None, hold: str | None) -> None:
    """From now on, hold messages that match the filter EXPRESSION. Without EXPRESSION, hold no further
    messages.
    """
    ctl.request(control.SetIntercept(expression or None, hold or None), control.DoneResponse)


@command.command("held", short_help="List the held messages.")
@click.pass_obj
def _held(ctl: _ControlCommand) -> None:
    """List the held messages. For each message, show its number, its content, and for how many seconds the
    proxy has held it.
    """
    response = ctl.request(control.ListHeld(), control.HeldResponse)
    for held in response.held if response else ():
        for line in _held_lines(held, ctl.words):
            echo(line)


def _held_lines(held: control.HeldStatus, words: MessageFormatter) -> list[str]:
    renderer = FrameLineRenderer(words=words)
    renderer.set_time_origin(0)
    waited = round(held.waited_s * 1e9)
    case = "control.held.dropped" if held.given_up else "control.held.sent"
    notes = [words(case, time=f"{held.left_s:.1f} s", reason=printable(held.given_up))]
    if held.retries:
        notes.append(words("control.held.retries", retries=Count(held.retries, "retry")))
    return [
        renderer.line(
            Observation(held.number, waited, waited, held.flow, item, 0), held.call_kind, tuple(notes)
        )
        for item in parse_datagram(held.data)
    ]


@command.command("edit", short_help="Change a held message and send it.")
@_NUMBER
@click.argument("changes", nargs=-1)
@click.option(
    "--hex", "data", metavar="BYTES", help="Send these bytes, given in hex, instead of the held message."
)
@click.pass_obj
def _edit(ctl: _ControlCommand, number: int, changes: tuple[str, ...], data: str | None) -> None:
    """Send a held message with CHANGES. Write CHANGES as for the fault `rewrite`, such as: set
    arg[2][0]=10.
    """
    ctl.request(control.EditHeld(number, data or "", " ".join(changes)), control.DoneResponse)


@command.command("clients", short_help="List the clients.")
@click.pass_obj
def _clients(ctl: _ControlCommand) -> None:
    """List the clients. For each client, show how long it has been connected, how many messages went in each
    direction, and its connection to the controller.
    """
    response = ctl.request(control.ListClients(), control.ClientsResponse)
    for client in response.clients if response else ():
        route = f"{client.client} > {client.server} {client.transport} {client.upstream}"
        traffic = ctl.words("control.client", time=f"{client.since_s:.1f} s", up=client.up, down=client.down)
        echo(f"{printable(route)}  {traffic}")


@command.command("stats", short_help="Show figures.")
@click.pass_obj
def _stats(ctl: _ControlCommand) -> None:
    """Show figures: injected faults, refusals, held messages and traffic."""
    response = ctl.request(control.GetStats(), control.ProxyStats)
    for name, value in msgspec.to_builtins(response).items() if response else ():
        if name not in ("ok", "struck", "held_up_ns"):
            echo(printable(f"{name.replace('_', ' ')}: {_figure_text(value)}"))


def _figure_text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {each}" for name, each in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)


def _add_change_command(
    name: str, help_: str, argument: options.Decorator, make: Callable[..., control.ControlRequest]
) -> None:

    @command.command(name, help=help_)
    @argument
    @click.pass_obj
    def change(ctl: _ControlCommand, /, **typed: Any) -> None:
        ctl.request(make(**typed), control.DoneResponse)


_add_change_command("remove", "Remove a fault.", _NAME, control.RemoveFault)
_add_change_command("on", "Switch a fault on.", _NAME, control.EnableFault)
_add_change_command("off", "Switch a fault off.", _NAME, control.DisableFault)
_add_change_command("forward", "Send a held message unchanged.", _NUMBER, control.ForwardHeld)
_add_change_command("drop", "Drop a held message.", _NUMBER, control.DropHeld)
