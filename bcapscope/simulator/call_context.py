"""The context in which the simulated controller runs a call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from bcapscope.protocol.codec.variant import Variant
from bcapscope.simulator.call_outcome import HandlerOutcome
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.object_table import ControllerObject, ObjectTable


@dataclass(slots=True)
class CallContext:
    """One call on an object of a client; `client` is the client's number, `now` the time in ns."""

    machine: Machine
    client: int
    objects: ObjectTable
    object: ControllerObject
    now: int


CommandHandler: TypeAlias = Callable[[CallContext, Variant], HandlerOutcome]
"""Handler of one command of an ..._Execute function; the handler gets the command's parameter."""

CommandTable: TypeAlias = Mapping[str, CommandHandler]
"""Handlers of commands, by command name in lower case."""


def accept_without_effect(context: CallContext, parameter: Variant) -> None:
    """Accept a command whose effect the simulator does not show, such as a setting."""
