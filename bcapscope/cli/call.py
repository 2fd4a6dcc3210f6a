"""``bcapscope call``: make one or several calls to a controller in one session."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import IO, Any, TextIO

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.arming_prompt import log_armed_calls, unarmed_reason
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.planned_call import LONGEST_LINE, PlannedCall, PlannedCallParser, check_owners
from bcapscope.cli.common.target_options import ControllerTarget, exit_on_failure, target_options
from bcapscope.client.action_log import ArmedCallLogger, LoggedConnection
from bcapscope.client.object_opener import DEFAULT_OBJECT_NAMES, ObjectOpener
from bcapscope.client.session import open_target_session
from bcapscope.errors import CallTimeout
from bcapscope.live.end_signals import run_interruptible
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.messages import MessageFormatter
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.retry.requester import CallRefused, CallTimedOut, RequesterOutcome
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.render.call_code import NAMED_OWNERS
from bcapscope.render.escape import printable
from bcapscope.render.hexdump import hexdump
from bcapscope.render.reply_text import reply_line, reply_record
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Observation


class _ScriptFile(click.File):
    """Parameter type for a text file or standard input. If standard input is closed, the user gets a usage
    error.
    """

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> IO[Any]:
        if value == "-" and sys.stdin is None:
            self.fail("standard input is closed; give a file", param, ctx)
        return super().convert(value, param, ctx)


@click.command(
    short_help="Call functions of a controller.", context_settings={"ignore_unknown_options": True}
)
@target_options
@click.argument("typed", nargs=-1, metavar="[FUNCTION [ARG]...]", type=click.UNPROCESSED)
@click.option(
    "-e",
    "--exec",
    "more",
    metavar="CALL",
    multiple=True,
    help="Make this call too, quoted as one word; may be repeated.",
)
@click.option(
    "--script",
    metavar="FILE",
    type=_ScriptFile(encoding="utf-8-sig"),
    help="Read calls from this file, one per line; - is standard input.",
)
@click.option("--robot", help="Open the robot of this name if a call needs one (default: Arm).")
@click.option("--task", help="Open the task of this name if a call needs one (default: RobSlave).")
@click.option(
    "--variable",
    help="Open the variable of this name if a call needs one: on the robot if only robots have this "
    "variable, otherwise on the controller.",
)
@click.option("--file", help="Open the file of this name if a call needs one.")
@click.option("--extension", help="Open the extension of this name if a call needs one.")
@click.option("--command", "command_", help="Open the command object of this name if a call needs one.")
@click.option("--arm", is_flag=True, help="Allow calls that may energise or move a robot.")
@click.option("--hex", "dump", is_flag=True, help="Show a hex dump of the packets below each call.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per call, with its reply.")
@options.color
@options.language
def command(
    *,
    target: ControllerTarget,
    typed: tuple[str, ...],
    more: tuple[str, ...],
    script: TextIO | None,
    arm: bool,
    dump: bool,
    as_json: bool,
    color: str,
    words: MessageFormatter,
    **named: str | None,
) -> None:
    """Call functions of a controller, such as `Robot_Execute slvGetMode`.

    `call` opens what a function needs and releases it afterwards: service, controller, and the object whose
    handle the function takes. Do not type the handle: `call` adds it to the arguments. Arguments get the
    types that the function, command or variable expects. To send another type, write the type before the
    value, as in i2:2 or r4[]:10,20,30. Missing arguments are empty. `call` ends at the first failure.

    Calls that may energise or move a robot need --arm, except to bcapscope's own simulator. Calls that stop
    a robot or switch it off do not need --arm. The action log records armed calls.

    Exit codes: 0: all calls succeeded; 2: invalid command line; 8: the controller refused a call; 9: no
    answer; 10: a call needs --arm.
    """
    if dump and as_json:
        raise click.UsageError("--hex and --json exclude each other")
    reader = PlannedCallParser(target, named["variable"])
    requests = [reader.parse(typed)] if typed else []
    requests += reader.parse_script(more)
    if script is not None:
        requests += reader.parse_script(iter(partial(script.readline, LONGEST_LINE + 1), ""))
    if not requests:
        raise click.UsageError("no function given. Give FUNCTION, --exec or --script")
    names = {owner: given for owner in NAMED_OWNERS if (given := _given_name(named, owner)) is not None}
    check_owners(requests, {*DEFAULT_OBJECT_NAMES, *names})
    calls = _CallRunner(target, names, arm, _AnswerPrinter(dump, as_json, color, words))
    with exit_on_failure(target, words):
        try:
            code = run_interruptible(calls.run(requests))
        except ValueError as error:
            raise click.UsageError(str(error)) from None
    sys.exit(code)


def _given_name(named: Mapping[str, str | None], owner: ObjectClass) -> str | None:
    word = owner.lower()
    return named[word] if word in named else named[f"{word}_"]


class _AnswerPrinter:
    """Prints the reply of each call, and with --hex a hex dump of the call's packets."""

    def __init__(self, dump: bool, as_json: bool, color: str, words: MessageFormatter) -> None:
        self._dump = dump
        self._as_json = as_json
        self._palette = choose_palette(color)
        self.words = words
        self.packets: list[Observation] = []

    def print_answer(
        self, request: PlannedCall, arguments: Sequence[Variant], settled: RequesterOutcome
    ) -> None:
        function = request.function
        name = call_name(function.id, arguments)
        if isinstance(settled, CallTimedOut):
            self._print_packets()
            raise CallTimeout(name, settled.attempts)
        reply, attempts, took = settled.reply, settled.attempts, settled.elapsed
        if self._as_json:
            seen = next(each for each in reversed(self.packets) if each.item is reply)
            command_name = name.partition(" ")[2] or None
            question = CallKind(function.id, command_name)
            echo(reply_record(seen, question, took, attempts))
        else:
            given = name, function.id, reply, took, attempts
            echo(reply_line(*given, palette=self._palette, words=self.words))
        self._print_packets()

    def _print_packets(self) -> None:
        if self._dump:
            echo("".join(f"{line}\n" for line in self._packet_lines()), end=False)

    def _packet_lines(self) -> Iterator[str]:
        for seen in self.packets:
            sent = seen.flow.direction is Direction.REQUEST
            peer = str(seen.flow.dst if sent else seen.flow.src)
            yield f"  {self.words('call.packet.sent' if sent else 'call.packet.received', peer=peer)}"
            yield from (f"  {line}" for line in hexdump(seen.item.raw, palette=self._palette))


@dataclass(slots=True)
class _CallRunner:
    """Makes all calls of the command line in one session."""

    target: ControllerTarget
    names: Mapping[ObjectClass, str]
    armed: bool
    printer: _AnswerPrinter
    log: ArmedCallLogger | None = None

    async def run(self, requests: Sequence[PlannedCall]) -> ExitCode:
        """Make the calls one after another, and stop at the first failure.

        With --arm, the action log records the calls that need arming.
        """
        if not self.armed:
            return await self._run_calls(requests)
        with log_armed_calls("call", LoggedConnection.of_target(self.target)) as self.log:
            return await self._run_calls(requests)

    async def _run_calls(self, requests: Sequence[PlannedCall]) -> ExitCode:
        printer = self.printer
        async with open_target_session(self.target, observer=self._on_packet) as session:
            opener = ObjectOpener(session, self.target, self.names)
            for request in requests:
                arguments = await request.arguments(opener)
                if not await self._is_allowed(request, arguments, opener):
                    return ExitCode.UNARMED
                printer.packets.clear()
                settled = await session.perform_call(request.function.id, arguments)
                printer.print_answer(request, arguments, settled)
                if isinstance(settled, CallRefused):
                    return ExitCode.REFUSED
        return ExitCode.OK

    def _on_packet(self, observation: Observation) -> None:
        self.printer.packets.append(observation)
        if self.log is not None:
            self.log.on_observation(observation)

    async def _is_allowed(
        self, request: PlannedCall, arguments: Sequence[Variant], opener: ObjectOpener
    ) -> bool:
        function_id = request.function.id
        if self.armed or not opener.session.needs_arming(function_id, arguments):
            return True
        self.armed = await opener.is_simulator()
        if not self.armed:
            name, host = call_name(function_id, arguments), self.target.host
            unsent = self.printer.words("call.not-sent", call=name, reason=unarmed_reason(host))
            print_stderr(printable(f"bcapscope: {unsent}"))
        return self.armed
