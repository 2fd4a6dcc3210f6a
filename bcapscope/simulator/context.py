"""What a call of the simulated controller has at hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from bcapscope.protocol.variant import Variant
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.objects import Object, Objects
from bcapscope.simulator.outcome import DONE, Outcome


@dataclass(slots=True)
class Context:
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
    objects: Objects
    object: Object
    now: int


Command: TypeAlias = Callable[[Context, Variant], Outcome]
"""A command of an ..._Execute function, with its vntParam."""

Commands: TypeAlias = Mapping[str, Command]
"""Commands by their names in lower case."""


def accepted(context: Context, parameter: Variant) -> Outcome:
    """Run a command of which nothing is to be seen here, such as a setting."""
    return DONE
