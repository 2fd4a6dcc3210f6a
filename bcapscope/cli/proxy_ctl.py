"""``bcapscope proxy ctl``: control a running proxy."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import TypeVar

import click
import msgspec

from bcapscope.cli.common import options
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.faults.quantities import Duration
from bcapscope.live.standard_streams import print_stderr
from bcapscope.protocol.codec.frame import parse_datagram
from bcapscope.protocol.text_format import counted
from bcapscope.proxy.control_answers import ClientStatus, ControlAnswer, FaultStatus, HeldStatus, parse_list
from bcapscope.proxy.control_client import ControlClient, ControlRefused
from bcapscope.proxy.control_socket import ControlError
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.traffic.observation import Observation

T = TypeVar("T")
R = TypeVar("R")

_INDENTED = re.compile(r"\n(?=  )")
"""Between a reason and its indented lines, which show the position in a rule. A reason has no other lines."""


@click.group("ctl", short_help="Control a running proxy.")
@click.argument("address")
@click.option("--json", "as_json", is_flag=True, help="Print the proxy's answer as JSON.")
@click.pass_context
def command(context: click.Context, address: str, as_json: bool) -> None:
    """Control the running proxy that was started with `--control ADDRESS`.

    Exit codes: 0: done; 2: invalid command line; 4: no proxy listens on ADDRESS; 8: the proxy refused.
    """
    context.obj = _ControlCommand(address, as_json)


class _ControlCommand:
    """Sends requests to a proxy; prints its answers if they are wanted as JSON."""

    def __init__(self, address: str, as_json: bool) -> None:
        self._address = address
        self._as_json = as_json

    def ask(self, **question: object) -> ControlAnswer:
        """Send a request; return the answer, or {} if it was printed as JSON. Exit if the proxy refuses."""
        return self._ask_or_print(question, lambda proxy: proxy.request(question), {})

    def ask_list(self, name: str, kind: type[T]) -> Sequence[T]:
        """Request a list; otherwise like `ask`."""
        question = {"do": name}
        return self._ask_or_print(question, lambda proxy: parse_list(proxy.request(question), name, kind), ())

    def ask_held(self) -> Sequence[HeldStatus]:
        """Request the held messages; otherwise like `ask`."""
        return self._ask_or_print({"do": "held"}, ControlClient.list_held, ())

    def _ask_or_print(
        self, question: Mapping[str, object], read: Callable[[ControlClient], R], printed: R
    ) -> R:
        with self._connected() as proxy:
            if not self._as_json:
                return read(proxy)
            echo(_json_text(proxy.request_raw(question)))
            return printed

    @contextmanager
    def _connected(self) -> Iterator[ControlClient]:
        with closing(ControlClient(self._address)) as proxy:
            try:
                yield proxy
            except ControlError as error:
                print_stderr(printable(str(error)))
                sys.exit(ExitCode.UNREADABLE)
            except msgspec.ValidationError:
                print_stderr(
                    printable(f"the program on {self._address} is not a bcapscope proxy of this version")
                )
                sys.exit(ExitCode.UNREADABLE)
            except ControlRefused as error:
                if self._as_json:
                    echo(_json_text(error.line))
                else:
                    for line in _INDENTED.split(str(error)):
                        print_stderr(printable(line))
                sys.exit(ExitCode.REFUSED)


def _json_text(line: bytes) -> str:
    """Return an answer unchanged, except that control characters are escaped for the terminal."""
    text = line.decode("utf-8", "replace").strip()
    return text if text.isprintable() else "".join(map(_json_character, text))


def _json_character(char: str) -> str:
    if char.isprintable():
        return char
    if char in "\t\r\n":  # JSON has them only between tokens
        return " "
    return "".join(f"\\u{unit:04x}" for unit in memoryview(char.encode("utf-16-le")).cast("H"))


@command.command("rules", short_help="List the faults.")
@click.pass_obj
def _rules(ctl: _ControlCommand) -> None:
    """List the faults, whether they are on, and how often they were injected."""
    for rule in ctl.ask_list("rules", FaultStatus):
        echo(
            f"{'on ' if rule.on else 'off'}  {printable(rule.name):<16} struck {rule.struck:<6}  "
            f"{printable(rule.rule)}"
        )


@command.command("add", short_help="Add a fault.")
@click.argument("rule")
@click.pass_obj
def _add(ctl: _ControlCommand, rule: str) -> None:
    """Add a fault in the notation of `proxy --fault`, and print its name."""
    answer = ctl.ask(do="add", rule=rule)
    if "name" in answer:
        echo(printable(str(answer["name"])))


@command.command("remove", short_help="Remove a fault.")
@click.argument("name")
@click.pass_obj
def _remove(ctl: _ControlCommand, name: str) -> None:
    """Remove a fault."""
    ctl.ask(do="remove", name=name)


@command.command("on", short_help="Switch a fault on.")
@click.argument("name")
@click.pass_obj
def _on(ctl: _ControlCommand, name: str) -> None:
    """Switch a fault on."""
    ctl.ask(do="on", name=name)


@command.command("off", short_help="Switch a fault off.")
@click.argument("name")
@click.pass_obj
def _off(ctl: _ControlCommand, name: str) -> None:
    """Switch a fault off."""
    ctl.ask(do="off", name=name)


def _duration_text(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    try:
        return None if value is None else Duration.read(value).text
    except ValueError as error:
        raise click.BadParameter(f"{error}", context, parameter) from None


@command.command("intercept", short_help="Change which messages are held.")
@click.argument("expression", required=False)
@click.option(
    "--hold",
    metavar="TIME",
    callback=_duration_text,
    help="Hold them at most this long, such as 60s (default: as before); see `proxy --hold`.",
)
@click.pass_obj
def _intercept(ctl: _ControlCommand, expression: str | None, hold: str | None) -> None:
    """From now on, hold messages that match the filter EXPRESSION; without it, hold none."""
    question = {"if": expression} if expression else {}
    ctl.ask(do="intercept", **question, **({"patience": hold} if hold else {}))


@command.command("held", short_help="List the held messages.")
@click.pass_obj
def _held(ctl: _ControlCommand) -> None:
    """List the held messages with number, seconds held, and content."""
    for held in ctl.ask_held():
        for line in _held_lines(held):
            echo(line)


def _held_lines(held: HeldStatus) -> list[str]:
    renderer = FrameLineRenderer()
    renderer.set_time_origin(0)
    waited = round(held.waited_s * 1e9)
    end = f"dropped in {held.left_s:.1f} s ({printable(held.given_up)})"
    notes = [end if held.given_up else f"sent unchanged in {held.left_s:.1f} s"]
    if held.more:
        notes.append(f"{counted(held.more, 'retry', 'retries')} held")
    return [
        renderer.line(
            Observation(held.number, waited, waited, held.flow, item, 0), held.call_kind, tuple(notes)
        )
        for item in parse_datagram(held.data)
    ]


@command.command("forward", short_help="Send a held message.")
@click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))
@click.pass_obj
def _forward(ctl: _ControlCommand, number: int) -> None:
    """Send a held message unchanged."""
    ctl.ask(do="forward", number=number)


@command.command("edit", short_help="Change a held message and send it.")
@click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))
@click.argument("changes", nargs=-1)
@click.option("--hex", "data", metavar="BYTES", help="Send these bytes instead, given in hex.")
@click.pass_obj
def _edit(ctl: _ControlCommand, number: int, changes: tuple[str, ...], data: str | None) -> None:
    """Send a held message with CHANGES, in the notation of the fault `rewrite`: set arg[2][0]=10."""
    ctl.ask(do="edit", number=number, hex=data or "", rewrite=" ".join(changes))


@command.command("drop", short_help="Drop a held message.")
@click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))
@click.pass_obj
def _drop(ctl: _ControlCommand, number: int) -> None:
    """Drop a held message."""
    ctl.ask(do="drop", number=number)


@command.command("clients", short_help="List the clients.")
@click.pass_obj
def _clients(ctl: _ControlCommand) -> None:
    """List the clients: connection time, messages in each direction, connection to the controller."""
    for client in ctl.ask_list("clients", ClientStatus):
        way = f"{client.client} > {client.server} {client.transport} {client.upstream}"
        echo(f"{printable(way)}  for {client.since_s:.1f} s, {client.up} up, {client.down} down")


@command.command("stats", short_help="Show figures.")
@click.pass_obj
def _stats(ctl: _ControlCommand) -> None:
    """Show figures: injected faults, refusals, held messages and traffic."""
    for name, value in ctl.ask(do="stats").items():
        if name != "ok":
            echo(printable(f"{name.replace('_', ' ')}: {_figure_text(value)}"))


def _figure_text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {each}" for name, each in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)
