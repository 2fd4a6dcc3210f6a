"""What a call of the simulated controller has at hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from bcapscope.protocol.codec.variant import Variant
from bcapscope.simulator.call_outcome import DONE, CallOutcome
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.object_table import ControllerObject, ObjectTable


@dataclass(slots=True)
class CallContext:
    """One call.

    Attributes:
        machine: the controller.
        client: number of the client.
        objects: what the client has opened.
        object: that the call is made on.
        now: ns.
    """

    machine: Machine
    client: int
    objects: ObjectTable
    object: ControllerObject
    now: int


CommandHandler: TypeAlias = Callable[[CallContext, Variant], CallOutcome]
"""A command of an ..._Execute function, with its vntParam."""

CommandTable: TypeAlias = Mapping[str, CommandHandler]
"""Commands by their names in lower case."""


def accept_without_effect(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run a command of which nothing is to be seen here, such as a setting."""
    return DONE
