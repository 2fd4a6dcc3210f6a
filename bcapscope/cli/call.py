"""``bcapscope call``: calls to a controller, one or several in one session."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import IO, Any, TextIO

import click

from bcapscope.cli import options
from bcapscope.cli.arming import armed_calls, unarmed
from bcapscope.cli.connection import Target, failures_told, target
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import echo, narrate, palette
from bcapscope.cli.request import LONGEST_LINE, Request, RequestReader, check_owners
from bcapscope.cli.signals import run_in_order
from bcapscope.client.action_log import LoggedConnection
from bcapscope.client.armed_calls import ArmedCalls
from bcapscope.client.reach import NAMES, Reach
from bcapscope.client.session import open_target
from bcapscope.errors import ExchangeTimeout
from bcapscope.protocol.commands import call_name
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.guard import needs_arming
from bcapscope.protocol.requester import Refused, Settled, TimedOut
from bcapscope.protocol.variant import Variant
from bcapscope.render.answer import AnswerRenderer
from bcapscope.render.escape import printable
from bcapscope.render.hexdump import hexdump
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.question import Question

_NAMED = (
    ObjectClass.ROBOT,
    ObjectClass.TASK,
    ObjectClass.VARIABLE,
    ObjectClass.FILE,
    ObjectClass.EXTENSION,
    ObjectClass.COMMAND,
)


class _Script(click.File):
    """A file or standard input, which may be closed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> IO[Any]:
        if value == "-" and sys.stdin is None:
            self.fail("standard input is closed", param, ctx)
        return super().convert(value, param, ctx)


@click.command(
    short_help="Call functions of a controller.", context_settings={"ignore_unknown_options": True}
)
@target
@click.argument("words", nargs=-1, metavar="[FUNCTION [ARG]...]", type=click.UNPROCESSED)
@click.option("-e", "--exec", "more", metavar="CALL", multiple=True, help="One more call, as one word.")
@click.option(
    "--script",
    metavar="FILE",
    type=_Script(encoding="utf-8-sig"),
    help="Calls, one a line; - is standard input.",
)
@click.option("--robot", help="Name of the robot that is opened where one is needed; Arm unless given.")
@click.option("--task", help="Likewise of the task; RobSlave unless given.")
@click.option("--variable", help="Likewise of the variable, of the robot if only robots have one.")
@click.option("--file", help="Likewise of the file.")
@click.option("--extension", help="Likewise of the extension.")
@click.option("--command", "command_", help="Likewise of the command.")
@click.option("--arm", is_flag=True, help="Allow calls that may energise or move a robot.")
@click.option("--hex", "dump", is_flag=True, help="Every packet that went out or came in, under its call.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a call: the reply.")
@options.color
def command(
    *,
    target: Target,
    words: tuple[str, ...],
    more: tuple[str, ...],
    script: TextIO | None,
    arm: bool,
    dump: bool,
    as_json: bool,
    color: str,
    **named: str | None,
) -> None:
    """Call functions of a controller, such as `Robot_Execute slvGetMode`.

    `call` opens what a function needs and releases it afterwards: service, controller, and the object whose
    handle the function takes. Leave this handle out of the arguments. Arguments get the types of the
    function, command or variable; name other types, as in i2:2 or r4[]:10,20,30. Missing arguments are empty.
    `call` ends at the first failure.

    Calls that may energise or move a robot need --arm, except to bcapscope's own simulator. Calls that stop
    it or switch it off never do. The action log records armed calls.

    Exit codes: 0 all calls succeeded; 2 invalid command line; 8 a call was refused; 9 no answer; 10 --arm is
    missing.
    """
    if dump and as_json:
        raise click.UsageError("--hex and --json exclude each other")
    reader = RequestReader(target, named["variable"])
    requests = [reader.read(words)] if words else []
    requests += reader.read_script(more)
    if script is not None:
        requests += reader.read_script(iter(partial(script.readline, LONGEST_LINE + 1), ""))
    if not requests:
        raise click.UsageError("which function? Give FUNCTION, --exec or --script")
    names = {owner: given for owner in _NAMED if (given := _given(named, owner)) is not None}
    check_owners(requests, {*NAMES, *names})
    calls = _Calls(target, names, arm, _Printer(dump, as_json, color))
    with failures_told(target):
        try:
            code = run_in_order(calls.make(requests))
        except ValueError as error:
            raise click.UsageError(str(error)) from None
    sys.exit(code)


def _given(named: Mapping[str, str | None], owner: ObjectClass) -> str | None:
    word = owner.lower()
    return named[word] if word in named else named[f"{word}_"]


class _Printer:
    """Writes answers, and under them the packets that belong to them."""

    def __init__(self, dump: bool, as_json: bool, color: str) -> None:
        self._dump = dump
        self._as_json = as_json
        self._palette = palette(color)
        self._renderer = AnswerRenderer(self._palette)
        self.packets: list[Observation] = []

    def answer(self, request: Request, arguments: Sequence[Variant], settled: Settled) -> None:
        """Write one answer; `packets` are those of its call."""
        function = request.function
        name = call_name(function.id, arguments)
        if isinstance(settled, TimedOut):
            self._packets()
            raise ExchangeTimeout(name, settled.attempts)
        reply, attempts, took = settled.reply, settled.attempts, settled.took
        if self._as_json:
            seen = next(each for each in reversed(self.packets) if each.item is reply)
            command_name = name.partition(" ")[2] or None
            question = Question(function.id, command_name)
            echo(self._renderer.record(seen, question, took, attempts))
        else:
            echo(self._renderer.line(name, function.id, reply, took, attempts))
        self._packets()

    def _packets(self) -> None:
        if self._dump:
            echo("".join(f"{line}\n" for line in self._dumped()), end=False)

    def _dumped(self) -> Iterator[str]:
        for seen in self.packets:
            sent = seen.flow.direction is Direction.REQUEST
            yield f"  {'sent to' if sent else 'received from'} {seen.flow.dst if sent else seen.flow.src}"
            yield from (f"  {line}" for line in hexdump(seen.item.raw, palette=self._palette))


class _Calls:
    """Makes calls in one session."""

    def __init__(
        self, target: Target, names: Mapping[ObjectClass, str], arm: bool, printer: _Printer
    ) -> None:
        self._target = target
        self._names = names
        self._armed = arm
        self._printer = printer
        self._log: ArmedCalls | None = None

    async def make(self, requests: Sequence[Request]) -> Exit:
        """Make all calls, up to the first that fails; log those that need arming, if they are armed."""
        if not self._armed:
            return await self._make(requests)
        with armed_calls("call", LoggedConnection.of_target(self._target)) as self._log:
            return await self._make(requests)

    async def _make(self, requests: Sequence[Request]) -> Exit:
        printer = self._printer
        async with open_target(self._target, observer=self._observe) as session:
            reach = Reach(session, self._target.service, self._target.connect, self._names)
            for request in requests:
                arguments = await request.arguments(reach)
                if not await self._may(request, arguments, reach):
                    return Exit.UNARMED
                printer.packets.clear()
                settled = await reach.exchange(request.function, arguments)
                printer.answer(request, arguments, settled)
                if isinstance(settled, Refused):
                    return Exit.REFUSED
        return Exit.OK

    def _observe(self, seen: Observation) -> None:
        self._printer.packets.append(seen)
        if self._log is not None:
            self._log.observe(seen)

    async def _may(self, request: Request, arguments: Sequence[Variant], reach: Reach) -> bool:
        function_id = request.function.id
        if self._armed or not needs_arming(function_id, arguments, reach.variable_named(arguments)):
            return True
        self._armed = await reach.meets_simulator()
        if not self._armed:
            name, host = call_name(function_id, arguments), self._target.host
            narrate(printable(f"bcapscope: {name} was not sent. {unarmed(host)}"))
        return self._armed
