"""The context in which the simulated controller runs a call."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.simulator.argument_values import Arguments, float_array, items_of
from bcapscope.simulator.call_outcome import HandlerOutcome
from bcapscope.simulator.kinematics import Joints, pose_of
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.object_table import ControllerObject, ObjectTable


@dataclass(slots=True)
class CallContext:
    """One call that the simulated controller executes. `client` is the client's number, `now` the time in ns.

    Attributes:
        arguments: Arguments of the function, without the handle of `object`.
        parameter: Parameter of the command that the call runs, or the value that the call writes.
    """

    machine: Machine
    client: int
    objects: ObjectTable
    object: ControllerObject
    now: int
    arguments: Arguments
    parameter: Variant = EMPTY

    @property
    def items(self) -> Arguments:
        return items_of(self.parameter)

    def real_array(self, numbers: Iterable[float]) -> Variant:
        """Return the numbers as an array of the type that the profile uses for poses."""
        return float_array(self.machine.profile.real, numbers)

    def current_pose(self, pose_type: PoseType) -> Variant:
        return self.real_array(pose_of(pose_type, self.joints))

    @property
    def joints(self) -> Joints:
        """The joints that the encoders show."""
        return self.machine.arm.actual(self.now)


CallHandler: TypeAlias = Callable[[CallContext], HandlerOutcome]
"""Executes a b-CAP function or a command."""

CommandTable: TypeAlias = Mapping[str, CallHandler]
"""Handlers of commands, by command name in lower case."""


def accept_without_effect(context: CallContext) -> None:
    """Accept a command that does not change the simulation, such as a setting."""
