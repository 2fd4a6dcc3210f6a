"""The effects that calls can have on the robot.

bcapscope derives the effects from the meanings of the functions in orin_bcap C/include/bcap_funcid.h and of
the commands in `commands.tsv`. Calls that could start a motion, and unknown calls, have the effect `MOVES`.
"""

from __future__ import annotations

from enum import IntEnum, auto
from types import MappingProxyType

from bcapscope.protocol.tables.table_rows import table_rows


class CallEffect(IntEnum):
    READS = auto()
    """Only reads data from the controller."""
    SESSION = auto()
    """Opens or closes the client's own session or handles; changes nothing on the robot."""
    CHANGES = auto()
    """Changes a state, a value or a setting of the controller."""
    ENERGISES = auto()
    """Powers the motors, permits motion, or makes running programs faster, as ExtSpeed does. The effect of
    Robot_Speed is only `CHANGES`, because Robot_Speed affects only the client's own motions.
    """
    MOVES = auto()
    """Moves the robot or a hand, starts a program, or may have such an effect."""


FUNCTION_EFFECTS = MappingProxyType(
    {int(row["id"]): CallEffect[row["effect"].upper()] for row in table_rows("functions")}
)
"""Effect of each function in the table. The arguments of a request may change the effect; see
`request_effect`.
"""


def function_effect(function_id: int) -> CallEffect:
    """Return the function's effect in the table, or `MOVES` if the function is unknown. The option @Create of
    GetFile makes the effect of a request stronger; see `request_effect`.
    """
    return FUNCTION_EFFECTS.get(function_id, CallEffect.MOVES)
