"""The strongest effect of a call: read, use the session, change a state, energise the robot, or move it.

The effects follow from the meaning of each function in orin_bcap C/include/bcap_funcid.h and of each command
in `commands.tsv`. Calls that could start a motion, and unknown calls, have the effect `MOVES`.
"""

from __future__ import annotations

from enum import IntEnum
from types import MappingProxyType

from bcapscope.protocol.tables.function_table import FUNCTIONS


class CallEffect(IntEnum):
    """Strongest effect that a call can have on the robot, from weakest to strongest."""

    READS = 0
    """Only reads data from the controller."""
    SESSION = 1
    """Opens or closes the client's own session or handles; nothing changes on the robot."""
    CHANGES = 2
    """Changes a state, a value or a setting of the controller."""
    ENERGISES = 3
    """Powers the motors, permits motion, or makes running programs faster, as ExtSpeed does. The weaker
    effect `CHANGES` is that of Robot_Speed, which only sets the speed of the client's own motions."""
    MOVES = 4
    """Moves the robot or a hand, or starts a program, or may do so."""


# Programs, hands and stored commands can cause any motion. Writing a variable can start a task (@START) or
# switch an output.
_MOVES = frozenset(
    (
        *("Robot_Chuck", "Robot_Drive", "Robot_Execute", "Robot_GoHome", "Robot_Move", "Robot_Rotate"),
        *("Robot_Unchuck", "Robot_Unhold", "Task_Execute", "Task_Start", "File_Execute", "File_Run"),
        *("Controller_Execute", "Extension_Execute", "Command_Execute", "Variable_PutValue"),
    )
)

_CHANGES = frozenset(
    (
        *("Robot_Accelerate", "Robot_Change", "Robot_Halt", "Robot_Hold", "Robot_Speed"),
        *("Task_Delete", "Task_Stop", "File_Copy", "File_Delete", "File_Move", "File_PutValue"),
        *("Command_Cancel", "Command_PutParameters", "Command_PutTimeout", "Message_Clear", "Message_Reply"),
    )
)


def _effect_of_function(function_id: int) -> CallEffect:
    function = FUNCTIONS[function_id]
    verb = function.name.partition("_")[2]
    if function.name in _MOVES:
        return CallEffect.MOVES
    if function.name in _CHANGES or verb in ("PutTag", "PutID"):
        return CallEffect.CHANGES
    if function.creates or function.releases:
        return CallEffect.SESSION
    return CallEffect.READS if verb.startswith("Get") else CallEffect.MOVES


FUNCTION_EFFECTS = MappingProxyType(
    {function_id: _effect_of_function(function_id) for function_id in FUNCTIONS}
)
"""Strongest effect of each function with any arguments. `guard` derives the effect from the arguments."""


def function_effect(function_id: int) -> CallEffect:
    """Return the strongest effect that a function can have; `MOVES` for an unknown id."""
    return FUNCTION_EFFECTS.get(function_id, CallEffect.MOVES)
