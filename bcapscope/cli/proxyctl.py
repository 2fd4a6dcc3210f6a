"""``bcapscope proxy ctl``: ask and tell a proxy that runs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import click
import orjson

from bcapscope.cli import options
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import echo, narrate
from bcapscope.faults.quantities import Duration
from bcapscope.protocol.frame import parse_datagram
from bcapscope.proxy.control_client import Answer, ControlClient, ControlRefused
from bcapscope.proxy.control_socket import ControlError
from bcapscope.render.escape import printable
from bcapscope.render.line import LineRenderer
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Observation, Transport
from bcapscope.traffic.question import Question


@click.group("ctl", short_help="Ask and tell a proxy that runs.")
@click.argument("address")
@click.option("--json", "as_json", is_flag=True, help="Print the answer as it came.")
@click.pass_context
def command(context: click.Context, address: str, as_json: bool) -> None:
    """Ask and tell the proxy that was started with `--control ADDRESS`.

    Exit codes: 0 done; 4 nobody listens there; 8 the proxy refused.
    """
    context.obj = _Ctl(address, as_json)


class _Ctl:
    """A way to the proxy."""

    def __init__(self, address: str, as_json: bool) -> None:
        self._address = address
        self._as_json = as_json

    def ask(self, **question: object) -> Answer | None:
        """Ask; give the answer, None if it was printed already. A refusal ends the program."""
        with closing(ControlClient(self._address)) as proxy:
            try:
                answer = proxy.ask(question)
            except ControlError as error:
                narrate(str(error))
                sys.exit(Exit.UNREADABLE)
            except ControlRefused as error:
                if self._as_json:
                    echo(orjson.dumps(error.answer).decode())
                else:
                    narrate(str(error))
                sys.exit(Exit.REFUSED)
        if self._as_json:
            echo(orjson.dumps(answer).decode())
        return None if self._as_json else answer


@command.command("rules", short_help="List the faults.")
@click.pass_obj
def _rules(ctl: _Ctl) -> None:
    """List the faults, whether they are on, and how often they have struck."""
    answer = ctl.ask(do="rules")
    for rule in answer["rules"] if answer else ():
        echo(
            f"{'on ' if rule['on'] else 'off'}  {rule['name']:<16} struck {rule['struck']:<6}  {rule['rule']}"
        )


@command.command("add", short_help="Set up a fault.")
@click.argument("rule")
@click.pass_obj
def _add(ctl: _Ctl, rule: str) -> None:
    """Set up a fault, written as behind `--fault`; its name is printed."""
    answer = ctl.ask(do="add", rule=rule)
    if answer:
        echo(answer["name"])


@command.command("remove", short_help="Take a fault away.")
@click.argument("name")
@click.pass_obj
def _remove(ctl: _Ctl, name: str) -> None:
    """Take a fault away."""
    ctl.ask(do="remove", name=name)


@command.command("on", short_help="Switch a fault on.")
@click.argument("name")
@click.pass_obj
def _on(ctl: _Ctl, name: str) -> None:
    """Switch a fault on."""
    ctl.ask(do="on", name=name)


@command.command("off", short_help="Switch a fault off.")
@click.argument("name")
@click.pass_obj
def _off(ctl: _Ctl, name: str) -> None:
    """Switch a fault off."""
    ctl.ask(do="off", name=name)


def _time(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    try:
        return None if value is None else Duration.read(value).text
    except ValueError as error:
        raise click.BadParameter(f"{error}", context, parameter) from None


@command.command("intercept", short_help="Hold other messages, or none.")
@click.argument("expression", required=False)
@click.option("--hold", metavar="TIME", callback=_time, help="How long, such as 60s; see `proxy --hold`.")
@click.pass_obj
def _intercept(ctl: _Ctl, expression: str | None, hold: str | None) -> None:
    """Hold what EXPRESSION is true for from now on; without it nothing more."""
    question = {"if": expression} if expression else {}
    ctl.ask(do="intercept", **question, **({"patience": hold} if hold else {}))


@command.command("held", short_help="List the messages that wait.")
@click.pass_obj
def _held(ctl: _Ctl) -> None:
    """List the messages that wait: their numbers, how many seconds they have waited, and what they say."""
    answer = ctl.ask(do="held")
    for held in answer["held"] if answer else ():
        for line in _lines(held):
            echo(line)


def _lines(held: Mapping[str, Any]) -> list[str]:
    ends = (_endpoint(held["client"]), _endpoint(held["server"]))
    conversation = Conversation(*ends, Transport(held["transport"]), "the proxy")
    flow = Flow(conversation, Direction(held["direction"]))
    question = None if held["function_id"] is None else Question(held["function_id"], held["command"])
    renderer = LineRenderer()
    renderer.begin(0)
    waited = round(held["waited_s"] * 1e9)
    fate = f"is dropped, as {held['given_up']}," if held["given_up"] else "goes on unchanged"
    left = [f"{fate} in {held['left_s']:.1f} s"]
    if held["more"]:
        left.append(f"{held['more']} more tries of it came")
    return [
        renderer.line(Observation(held["number"], waited, waited, flow, item, 0), question, tuple(left))
        for item in parse_datagram(bytes.fromhex(held["hex"]))
    ]


def _endpoint(text: str) -> Endpoint:
    host, _, port = text.rpartition(":")
    return Endpoint(host.strip("[]"), int(port))


@command.command("forward", short_help="Send a message on.")
@click.argument("number", type=options.Whole(1, options.LARGEST_COUNT))
@click.pass_obj
def _forward(ctl: _Ctl, number: int) -> None:
    """Send a message on as it came."""
    ctl.ask(do="forward", number=number)


@command.command("edit", short_help="Send a message on, changed.")
@click.argument("number", type=options.Whole(1, options.LARGEST_COUNT))
@click.argument("changes", nargs=-1)
@click.option("--hex", "data", metavar="BYTES", help="Send these bytes in its place.")
@click.pass_obj
def _edit(ctl: _Ctl, number: int, changes: tuple[str, ...], data: str | None) -> None:
    """Send a message on with CHANGES, as behind the fault `rewrite`: set arg[2][0]=10."""
    ctl.ask(do="edit", number=number, hex=data or "", rewrite=" ".join(changes))


@command.command("drop", short_help="Drop a message.")
@click.argument("number", type=options.Whole(1, options.LARGEST_COUNT))
@click.pass_obj
def _drop(ctl: _Ctl, number: int) -> None:
    """Drop a message that waits."""
    ctl.ask(do="drop", number=number)


@command.command("clients", short_help="List the clients.")
@click.pass_obj
def _clients(ctl: _Ctl) -> None:
    """List who is there: since when, what came from each side, and how the way to the controller is."""
    answer = ctl.ask(do="clients")
    for client in answer["clients"] if answer else ():
        way = f"{client['client']} > {client['server']} {client['transport']} {client['upstream']}"
        echo(f"{way}  for {client['since_s']:.1f} s, {client['up']} up, {client['down']} down")


@command.command("stats", short_help="Give figures.")
@click.pass_obj
def _stats(ctl: _Ctl) -> None:
    """Give figures: strikes, refusals, what is held, what has passed."""
    answer = ctl.ask(do="stats")
    for name, value in (answer or {}).items():
        if name != "ok":
            echo(f"{name.replace('_', ' ')}: {printable(_figure(value))}")


def _figure(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {each}" for name, each in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)
