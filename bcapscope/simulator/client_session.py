"""One client of the simulated controller: its session, its handles, and the calls that it may make."""

from __future__ import annotations

from collections.abc import Mapping

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.guard import always_passes
from bcapscope.protocol.tables.call_effect import CallEffect, function_effect
from bcapscope.protocol.tables.command_catalogue import CommandSpec, command_name, commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.hresult import (
    E_CAO_COLLECTION_REGISTERED,
    E_INVALIDARG,
    E_NOT_CONNECTED,
    E_NOTIMPL,
    E_REFUSED_IN_SLAVE_MODE,
)
from bcapscope.simulator.argument_values import Arguments, i4
from bcapscope.simulator.arm import MS
from bcapscope.simulator.call_context import CallContext
from bcapscope.simulator.call_outcome import (
    DONE,
    CallOutcome,
    CallResult,
    HandlerOutcome,
    RefusedError,
    RunningCall,
)
from bcapscope.simulator.function_handlers import FUNCTION_HANDLERS
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.object_table import ObjectTable

SHORTEST_WDT = 80
"""Shortest time in ms that a client may choose with the options WDT and InvokeTimeout."""

DEFAULT_INVOKE_TIMEOUT = 180_000
"""Default of InvokeTimeout in ms."""

LONGEST_QUOTED = 60
"""Maximum number of characters that the reason of a refusal quotes from a client's text."""

_START, _CONNECT = 1, 3
_VARIABLE_PUT = 102
_SLAVE_MODE_COMMANDS = frozenset(("slvchangemode", "slvmove", "handstop", "twofgstop"))
_OTHER_CLIENTS_COMMANDS = frozenset(
    (
        *("handmovea", "handmover", "handmoveh", "handmoveah", "handmoverh", "handmovevh"),
        *("handchuck", "handunchuck", "chuck", "unchuck"),
    )
)
"""Commands that a client may call while another client is in slave mode."""


class ClientSession:
    """The session of one client. `wdt` is the time in ns between two notices; None for no notices."""

    def __init__(self, machine: Machine, number: int) -> None:
        self.machine = machine
        self.number = number
        self.is_started = False
        self.wdt: int | None = None
        self.invoke_timeout = DEFAULT_INVOKE_TIMEOUT * MS
        self.objects = ObjectTable()

    def call(self, function_id: int, arguments: tuple[Variant, ...], now: int) -> CallOutcome:
        """Run a call and return its outcome. Invalid input also leads to an outcome, not to an exception."""
        self.machine.advance(now)
        try:
            outcome = self._call(function_id, arguments, now)
        except RefusedError as refusal:
            return CallResult(refusal.hresult, reason=refusal.reason)
        if isinstance(outcome, CallResult | RunningCall):
            return outcome
        return DONE if outcome is None else CallResult(value=outcome)

    def end(self) -> None:
        """Release all objects and the arm of this client, as DENSO's C server does for a lost client."""
        self.is_started = False
        self.wdt = None
        self.objects.clear()
        self.machine.open_objects.pop(self.number, None)
        if self.machine.owner == self.number:
            self.machine.owner = None
            self.machine.equipment.brackets.clear()

    def _call(self, function_id: int, arguments: tuple[Variant, ...], now: int) -> HandlerOutcome:
        method = FUNCTION_HANDLERS.get(function_id)
        if method is None or not self.is_started:
            return self._call_without_object(function_id, Arguments(arguments))
        owner, handler = method
        if not arguments:
            raise RefusedError(E_INVALIDARG)
        found = self.objects.find(owner, arguments[0])
        if handler is None:
            raise RefusedError(E_NOTIMPL)
        machine = self.machine
        if machine.slave.mode is not None:
            is_other = machine.owner != self.number
            if not is_allowed_in_slave_mode(function_id, arguments, is_other):
                machine.refuse(E_REFUSED_IN_SLAVE_MODE, now)
        own = Arguments(arguments[1:])
        return handler(CallContext(machine, self.number, self.objects, found, now, own))

    def _call_without_object(self, function_id: int, arguments: Arguments) -> Variant | None:
        if function_id not in FUNCTIONS:
            raise RefusedError(E_INVALIDARG)
        if function_id == _START:
            self._start(arguments)
        elif not self.is_started:
            raise RefusedError(E_NOT_CONNECTED)
        elif function_id == _CONNECT:
            return self._connect(arguments)
        else:
            self.end()
        return None

    def _start(self, arguments: Arguments) -> None:
        options = parse_options(arguments.text(0, default=""))
        wdt = _milliseconds(options.get("wdt"))
        limit = _milliseconds(options.get("invoketimeout"))
        self.wdt = None if wdt is None else wdt * MS
        self.invoke_timeout = (DEFAULT_INVOKE_TIMEOUT if limit is None else limit) * MS
        self.is_started = True
        self.machine.open_objects[self.number] = self.objects

    def _connect(self, arguments: Arguments) -> Variant:
        """Handle Controller_Connect. RC7 accepts any provider, and a name that is already in use. The other
        controllers refuse an unknown provider, and refuse a used name without the option @IfNotMember.

        If a client crashes, the names of its controller objects stay in use until the client is removed.
        """
        name, provider, _, option = (arguments.text(index) for index in range(4))
        providers = self.machine.profile.providers
        if providers and provider.strip().casefold() not in map(str.casefold, providers):
            raise RefusedError(E_INVALIDARG, _provider_reason(provider.strip(), providers))
        if name and providers and "@ifnotmember" not in option.casefold():
            for objects in self.machine.open_objects.values():
                if objects.find_by_name(ObjectClass.CONTROLLER, name, None):
                    raise RefusedError(E_CAO_COLLECTION_REGISTERED)
        option = option if name else ""
        return i4(self.objects.open_named(ObjectClass.CONTROLLER, name, None, option).handle)


def _provider_reason(provider: str, providers: tuple[str, ...]) -> str:
    asked = f"provider {provider[:LONGEST_QUOTED]!r} is not simulated" if provider else "no provider is given"
    return f"Controller_Connect is refused: {asked}. This profile simulates {' or '.join(providers)}"


def is_allowed_in_slave_mode(function_id: int, arguments: tuple[Variant, ...], is_other: bool) -> bool:
    """Return whether slave mode accepts a call; `is_other` means that another client has the arm.

    Sources: issues 13, 21, 42 and 48 of DENSORobot/denso_robot_ros. Return True for an unknown command, which
    the handler of the ..._Execute function then refuses.
    """
    refused = _REFUSED_COMMANDS.get(function_id)
    if refused is not None:
        name = (command_name(function_id, arguments) or "").casefold()
        return name not in refused or (is_other and name in _OTHER_CLIENTS_COMMANDS)
    if always_passes(function_id, arguments) or function_id == _VARIABLE_PUT:
        return True
    return function_effect(function_id) < CallEffect.MOVES


def _is_command_allowed(known: CommandSpec) -> bool:
    if known.name.casefold() in _SLAVE_MODE_COMMANDS:
        return True
    return known.effect <= CallEffect.READS if known.in_slave_mode is None else known.in_slave_mode


_REFUSED_COMMANDS: Mapping[int, frozenset[str]] = {
    function_id: frozenset(
        known.name.casefold() for known in commands_of(function_id) if not _is_command_allowed(known)
    )
    for function_id in (17, 28, 64, 87)
}
"""Names in lower case of the commands that slave mode refuses, for each id of an ..._Execute function."""


def parse_options(text: str) -> dict[str, str]:
    """Parse options such as `,WDT=400`. Option names become lower case; options without `=` are ignored."""
    pairs = (part.partition("=") for part in text[:1024].split(","))
    return {key.strip().casefold(): value.strip() for key, equals, value in pairs if equals}


def _milliseconds(text: str | None) -> int | None:
    if text is None:
        return None
    if not text.isascii() or not text.isdecimal() or len(text) > 9 or int(text) < SHORTEST_WDT:
        raise RefusedError(E_INVALIDARG)
    return int(text)
