"""The strongest effect of a call: read, use the session, change a state, energise the robot, or move the
robot.

The effects follow from the meaning of each function in orin_bcap C/include/bcap_funcid.h and of each command
in `commands.tsv`. Calls that could start a motion, and unknown calls, have the effect `MOVES`.
"""

from __future__ import annotations

from enum import IntEnum
from types import MappingProxyType

from bcapscope.protocol.tables.table_rows import table_rows


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


FUNCTION_EFFECTS = MappingProxyType(
    {int(row["id"]): CallEffect[row["effect"].upper()] for row in table_rows("functions")}
)
"""Strongest effect of each function with any arguments. `guard` derives the effect from the arguments."""


def function_effect(function_id: int) -> CallEffect:
    """Return the strongest effect that a function can have; `MOVES` for an unknown id."""
    return FUNCTION_EFFECTS.get(function_id, CallEffect.MOVES)
