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
    """One call that the simulated controller executes. `client` is the number of the client, `now` the time
    in ns."""

    machine: Machine
    client: int
    objects: ObjectTable
    object: ControllerObject
    now: int


CommandHandler: TypeAlias = Callable[[CallContext, Variant], HandlerOutcome]
"""Python function that executes one command, such as a command of Robot_Execute. It gets the command's
parameter.
"""

CommandTable: TypeAlias = Mapping[str, CommandHandler]
"""Handlers of commands, by command name in lower case."""


def accept_without_effect(context: CallContext, parameter: Variant) -> None:
    """Accept a command that does not change the simulation, such as a setting."""
