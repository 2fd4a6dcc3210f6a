"""``bcapscope call``: make one or several calls to a controller in one session."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from typing import IO, Any, TextIO

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.arming_prompt import log_armed_calls, unarmed_reason
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode, usage_error_on
from bcapscope.cli.common.target_options import ControllerTarget, exit_on_failure, target_options
from bcapscope.client.action_log import ArmedCallLogger, LoggedConnection
from bcapscope.client.object_opener import DEFAULT_OBJECT_NAMES, ObjectOpener
from bcapscope.client.session import open_target_session
from bcapscope.errors import CallTimeout
from bcapscope.live.end_signals import run_interruptible
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.messages import MessageFormatter
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.codec.variant_notation import parse_variant_as
from bcapscope.protocol.retry.requester import CallRefused, CallTimedOut, RequesterOutcome
from bcapscope.protocol.tables.command_catalogue import call_name, find_command
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass, Param, function_by_name
from bcapscope.protocol.tables.variables import find_variable
from bcapscope.protocol.text_format import shortened
from bcapscope.render.call_code import NAMED_OWNERS
from bcapscope.render.color_palette import Palette
from bcapscope.render.escape import printable
from bcapscope.render.hexdump import hexdump
from bcapscope.render.reply_text import reply_line, reply_record
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Observation

LONGEST_LINE = 65536
"""Maximum number of characters in a line of a script."""

_LONGEST_SHOWN = 60  # an error message shows at most this number of characters of an argument

_OWNERS_OF_VARIABLES = (ObjectClass.CONTROLLER, ObjectClass.ROBOT, ObjectClass.TASK)
_NAMELESS_OWNERS = (ObjectClass.SERVICE, ObjectClass.CONTROLLER, ObjectClass.MESSAGE)


class _ScriptFile(click.File):
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> IO[Any]:
        if value == "-" and sys.stdin is None:
            self.fail("standard input is closed; give a file", param, ctx)
        return super().convert(value, param, ctx)


@click.command(context_settings={"ignore_unknown_options": True})
@target_options
@click.argument("typed", nargs=-1, metavar="[FUNCTION [ARG]...]", type=click.UNPROCESSED)
@click.option(
    "-e",
    "--exec",
    "more",
    metavar="CALL",
    multiple=True,
    help="Make another call. Put the whole call in quotes. You can repeat this option.",
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
@click.option("--command", help="Open the command object of this name if a call needs one.")
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

    `call` opens the service, the controller and the object that a function needs. At the end, `call` releases
    everything that it opened. Do not type a handle: `call` adds the object's handle to the arguments. `call`
    sends each argument with the type that the function, command or variable expects. To send another type,
    write the type before the value, as in i2:2 or r4[]:10,20,30. Missing arguments are empty. `call` ends at
    the first failure.

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
    names = {owner: name for owner in NAMED_OWNERS if (name := named[owner.lower()]) is not None}
    check_owners(requests, {*DEFAULT_OBJECT_NAMES, *names})
    calls = _CallRunner(target, names, words, arm, dump, as_json, choose_palette(color))
    with exit_on_failure(target, words), usage_error_on(ValueError):
        code = run_interruptible(calls.run(requests))
    sys.exit(code)


@dataclass(slots=True)
class _CallRunner:
    target: ControllerTarget
    names: Mapping[ObjectClass, str]
    words: MessageFormatter
    armed: bool
    dump: bool
    as_json: bool
    palette: Palette
    _packets: list[Observation] = field(default_factory=list)
    _log: ArmedCallLogger | None = None

    async def run(self, requests: Sequence[PlannedCall]) -> ExitCode:
        """Make the calls, and stop at the first failure. With --arm, the action log records armed calls."""
        with ExitStack() as stack:
            if self.armed:
                connection = LoggedConnection.of_target(self.target)
                self._log = stack.enter_context(log_armed_calls("call", connection))
            async with open_target_session(self.target, observer=self._on_packet) as session:
                opener = ObjectOpener(session, self.target, self.names)
                for request in requests:
                    arguments = await request.arguments(opener)
                    if not await self._is_allowed(request, arguments, opener):
                        return ExitCode.UNARMED
                    self._packets.clear()
                    settled = await session.perform_call(request.function.id, arguments)
                    self._print_answer(request, arguments, settled)
                    if isinstance(settled, CallRefused):
                        return ExitCode.REFUSED
        return ExitCode.OK

    def _on_packet(self, observation: Observation) -> None:
        self._packets.append(observation)
        if self._log is not None:
            is_request = observation.flow.direction is Direction.REQUEST
            self._log.add_frame(is_request, observation.item.raw, observation.time)

    async def _is_allowed(
        self, request: PlannedCall, arguments: Sequence[Variant], opener: ObjectOpener
    ) -> bool:
        function_id = request.function.id
        if self.armed or not opener.session.needs_arming(function_id, arguments):
            return True
        self.armed = await opener.is_simulator()
        if not self.armed:
            name, host = call_name(function_id, arguments), self.target.host
            unsent = self.words("call.not-sent", call=name, reason=unarmed_reason(host))
            print_stderr(printable(f"bcapscope: {unsent}"))
        return self.armed

    def _print_answer(
        self, request: PlannedCall, arguments: Sequence[Variant], settled: RequesterOutcome
    ) -> None:
        function_id = request.function.id
        name = call_name(function_id, arguments)
        if isinstance(settled, CallTimedOut):
            self._print_packets()
            raise CallTimeout(name, settled.attempts)
        reply, attempts, took = settled.reply, settled.attempts, settled.elapsed
        if self.as_json:
            seen = next(each for each in reversed(self._packets) if each.item is reply)
            call_kind = CallKind(function_id, name.partition(" ")[2] or None)
            echo(reply_record(seen, call_kind, took, attempts))
        else:
            echo(reply_line(name, function_id, reply, took, attempts, palette=self.palette, words=self.words))
        self._print_packets()

    def _print_packets(self) -> None:
        for seen in self._packets if self.dump else ():
            sent = seen.flow.direction is Direction.REQUEST
            peer = str(seen.flow.dst if sent else seen.flow.src)
            echo(f"  {self.words('call.packet.sent' if sent else 'call.packet.received', peer=peer)}")
            for line in hexdump(seen.item.raw, palette=self.palette):
                echo(f"  {line}")


@dataclass(frozen=True, slots=True)
class PlannedCall:
    """A call to make. `values` holds the arguments, without the handle if `opens_object` is True."""

    function: Function
    values: tuple[Variant, ...]
    opens_object: bool

    async def arguments(self, opener: ObjectOpener) -> tuple[Variant, ...]:
        if self.opens_object:
            return (Variant(VT.I4, await opener.handle_for(self.function.owner)), *self.values)
        if self.function.name == "Controller_Connect":
            await opener.start_service()
        return self.values


class PlannedCallParser:
    def __init__(self, target: ControllerTarget, variable_name: str | None) -> None:
        self._target = target
        self._types = _variable_types(variable_name, _OWNERS_OF_VARIABLES) if variable_name else ()

    def parse(self, words: Sequence[str]) -> PlannedCall:
        """Parse one call. Raises click.UsageError for an unknown function or wrong arguments."""
        name, *texts = words
        function = function_by_name(name)
        if function is None:
            near = get_close_matches(name, [each.name for each in FUNCTIONS.values()], 1)
            hint = f". Did you mean {near[0]}?" if near else ""
            raise click.UsageError(f"unknown function {name!r}{hint}")
        params = function.params
        takes_handle = function.takes_handle and not _begins_with_handle(params, texts)
        if takes_handle:
            params = params[1:]
        if len(texts) > len(params):
            raise click.UsageError(_too_many_text(function, params, texts))
        defaults = {"Controller_Connect": self._target.connect, "Service_Start": (self._target.service,)}
        texts = [*texts, *defaults.get(function.name, ())[len(texts) :]]
        types = self._types if takes_handle and function.name == "Variable_PutValue" else ()
        values = tuple(
            _parse_argument(function, index, param, texts, types) for index, param in enumerate(params)
        )
        if function.creates is ObjectClass.VARIABLE:
            opened = str(values[0 if takes_handle else 1].value)
            self._types = _variable_types(opened, (function.owner,))
        return PlannedCall(function, values, takes_handle)

    def parse_script(self, lines: Iterable[str]) -> list[PlannedCall]:
        """Parse one call per line by the quoting rules of a POSIX shell, or raise click.UsageError. Empty
        lines and # comments are skipped.
        """
        requests = []
        number = 1
        try:
            for line in lines:
                if len(line) > LONGEST_LINE:
                    raise ValueError(f"longer than {LONGEST_LINE} characters")
                words = shlex.split(line, comments=True)
                if words:
                    requests.append(self.parse(words))
                number += 1
        except UnicodeError:
            raise click.UsageError(f"line {number} or later: not UTF-8") from None
        except (ValueError, click.UsageError) as error:
            reason = error.message if isinstance(error, click.UsageError) else str(error).lower()
            raise click.UsageError(f"line {number}: {reason}") from None
        return requests


def check_owners(requests: Iterable[PlannedCall], named: Collection[ObjectClass]) -> None:
    """Raise click.UsageError if a call needs an object that no option names and no earlier call opens."""
    always = {*_NAMELESS_OWNERS, *named}
    known = set(always)
    for request in requests:
        owner = request.function.owner
        if request.opens_object and owner not in known:
            word = owner.lower()
            raise click.UsageError(
                f"{request.function.name}: no {word} is open. "
                f"Add --{word} NAME, or open the {word} in an earlier call"
            )
        if request.function.creates is not None:
            known.add(request.function.creates)
        if request.function.releases is not None and request.opens_object and owner not in always:
            known.discard(owner)


def _begins_with_handle(params: Sequence[Param], texts: Sequence[str]) -> bool:
    if len(texts) < len(params):
        return False
    try:
        return parse_variant_as(texts[0], [params[0].type]).vt == VT.I4
    except ValueError:
        return False


def _too_many_text(function: Function, params: Sequence[Param], texts: Sequence[str]) -> str:
    extra = texts[len(params) :]
    quoted = ", ".join(repr(shortened(text, _LONGEST_SHOWN)) for text in extra)
    text = f"{function.name} takes {_names_of(params)}. Remove {quoted}"
    if params and params[-1].type == "VARIANT":
        joined = shortened(",".join(texts[len(params) - 1 :]), _LONGEST_SHOWN)
        text += f". If {params[-1].name} has several values, separate them with commas: {joined}"
    return text


def _names_of(params: Sequence[Param]) -> str:
    return " ".join(param.name for param in params) or "no arguments"


def _variable_types(variable_name: str, owners: Iterable[ObjectClass]) -> tuple[str, ...]:
    known = (find_variable(owner, variable_name) for owner in owners)
    return next((kind.types for kind in known if kind), ())


def _parse_argument(
    function: Function, index: int, param: Param, texts: Sequence[str], types: Sequence[str]
) -> Variant:
    if index >= len(texts):
        if param.type == "VT_BSTR":
            return Variant(VT.BSTR, "")
        if param.type == "VARIANT":
            return EMPTY
        names = _names_of(function.params)
        raise click.UsageError(f"{function.name} takes {names}; {param.name} is missing")
    if param.name == "vntParam" and (known := find_command(function.id, texts[index - 1])):
        types = known.parameter_types
    try:
        return parse_variant_as(texts[index], types or [param.type])
    except ValueError as error:
        raise click.UsageError(f"{function.name}, {param.name}: {error}") from None
