"""``bcapscope proxy ctl``: ask and tell a proxy that runs."""

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
from bcapscope.proxy.control_answers import ClientStatus, ControlAnswer, FaultStatus, HeldStatus, parse_list
from bcapscope.proxy.control_client import ControlClient, ControlRefused
from bcapscope.proxy.control_socket import ControlError
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.traffic.observation import Observation

T = TypeVar("T")
R = TypeVar("R")

_INDENTED = re.compile(r"\n(?=  )")
"""Where a reason goes on in an indented line, which shows the place in a rule. No reason has other lines."""


@click.group("ctl", short_help="Ask and tell a proxy that runs.")
@click.argument("address")
@click.option("--json", "as_json", is_flag=True, help="Print the answer as it came.")
@click.pass_context
def command(context: click.Context, address: str, as_json: bool) -> None:
    """Ask and tell the proxy that was started with `--control ADDRESS`.

    Exit codes: 0 done; 4 nobody listens there; 8 the proxy refused.
    """
    context.obj = _ControlCommand(address, as_json)


class _ControlCommand:
    """The way to a proxy, and the form of what is printed."""

    def __init__(self, address: str, as_json: bool) -> None:
        self._address = address
        self._as_json = as_json

    def ask(self, **question: object) -> ControlAnswer:
        """Ask; return the answer, or {} if it was printed as JSON. A refusal ends the program."""
        return self._ask_or_print(question, lambda proxy: proxy.request(question), {})

    def ask_list(self, name: str, kind: type[T]) -> Sequence[T]:
        """Ask for a list; as `ask`."""
        question = {"do": name}
        return self._ask_or_print(question, lambda proxy: parse_list(proxy.request(question), name, kind), ())

    def ask_held(self) -> Sequence[HeldStatus]:
        """Ask for the messages that wait; as `ask`."""
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
    """Write an answer as it came, but with every character escaped that a terminal may obey."""
    text = line.decode("utf-8", "replace").strip()
    return text if text.isprintable() else "".join(map(_json_character, text))


def _json_character(char: str) -> str:
    if char.isprintable():
        return char
    if char in "\t\r\n":  # JSON has them only between its parts
        return " "
    return "".join(f"\\u{unit:04x}" for unit in memoryview(char.encode("utf-16-le")).cast("H"))


@command.command("rules", short_help="List the faults.")
@click.pass_obj
def _rules(ctl: _ControlCommand) -> None:
    """List the faults, whether they are on, and how often they have struck."""
    for rule in ctl.ask_list("rules", FaultStatus):
        echo(
            f"{'on ' if rule.on else 'off'}  {printable(rule.name):<16} struck {rule.struck:<6}  "
            f"{printable(rule.rule)}"
        )


@command.command("add", short_help="Set up a fault.")
@click.argument("rule")
@click.pass_obj
def _add(ctl: _ControlCommand, rule: str) -> None:
    """Set up a fault, written as behind `--fault`; its name is printed."""
    answer = ctl.ask(do="add", rule=rule)
    if "name" in answer:
        echo(printable(str(answer["name"])))


@command.command("remove", short_help="Take a fault away.")
@click.argument("name")
@click.pass_obj
def _remove(ctl: _ControlCommand, name: str) -> None:
    """Take a fault away."""
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


@command.command("intercept", short_help="Hold other messages, or none.")
@click.argument("expression", required=False)
@click.option(
    "--hold", metavar="TIME", callback=_duration_text, help="How long, such as 60s; see `proxy --hold`."
)
@click.pass_obj
def _intercept(ctl: _ControlCommand, expression: str | None, hold: str | None) -> None:
    """Hold what EXPRESSION is true for from now on; without it nothing more."""
    question = {"if": expression} if expression else {}
    ctl.ask(do="intercept", **question, **({"patience": hold} if hold else {}))


@command.command("held", short_help="List the messages that wait.")
@click.pass_obj
def _held(ctl: _ControlCommand) -> None:
    """List the messages that wait: their numbers, how many seconds they have waited, and what they say."""
    for held in ctl.ask_held():
        for line in _held_lines(held):
            echo(line)


def _held_lines(held: HeldStatus) -> list[str]:
    renderer = FrameLineRenderer()
    renderer.set_time_origin(0)
    waited = round(held.waited_s * 1e9)
    fate = f"is dropped, as {printable(held.given_up)}," if held.given_up else "goes on unchanged"
    left = [f"{fate} in {held.left_s:.1f} s"]
    if held.more:
        left.append(f"{held.more} more tries of it came")
    return [
        renderer.line(
            Observation(held.number, waited, waited, held.flow, item, 0), held.call_kind, tuple(left)
        )
        for item in parse_datagram(held.data)
    ]


@command.command("forward", short_help="Send a message on.")
@click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))
@click.pass_obj
def _forward(ctl: _ControlCommand, number: int) -> None:
    """Send a message on as it came."""
    ctl.ask(do="forward", number=number)


@command.command("edit", short_help="Send a message on, changed.")
@click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))
@click.argument("changes", nargs=-1)
@click.option("--hex", "data", metavar="BYTES", help="Send these bytes in its place.")
@click.pass_obj
def _edit(ctl: _ControlCommand, number: int, changes: tuple[str, ...], data: str | None) -> None:
    """Send a message on with CHANGES, as behind the fault `rewrite`: set arg[2][0]=10."""
    ctl.ask(do="edit", number=number, hex=data or "", rewrite=" ".join(changes))


@command.command("drop", short_help="Drop a message.")
@click.argument("number", type=options.IntegerRange(1, options.LARGEST_COUNT))
@click.pass_obj
def _drop(ctl: _ControlCommand, number: int) -> None:
    """Drop a message that waits."""
    ctl.ask(do="drop", number=number)


@command.command("clients", short_help="List the clients.")
@click.pass_obj
def _clients(ctl: _ControlCommand) -> None:
    """List who is there: since when, what came from each side, and how the way to the controller is."""
    for client in ctl.ask_list("clients", ClientStatus):
        way = f"{client.client} > {client.server} {client.transport} {client.upstream}"
        echo(f"{printable(way)}  for {client.since_s:.1f} s, {client.up} up, {client.down} down")


@command.command("stats", short_help="Give figures.")
@click.pass_obj
def _stats(ctl: _ControlCommand) -> None:
    """Give figures: strikes, refusals, what is held, what has passed."""
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
