"""Infer the generation of a controller from the traffic.

The same slave mode differs between generations, and no message names the generation.
"""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant, integer_value
from bcapscope.protocol.slave_mode.modes import Generation, slave_mode_by_number
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call

_CONNECT = ID["Controller_Connect"]
_ROBOT_EXECUTE = ID["Robot_Execute"]
_CONTROLLER_EXECUTE = ID["Controller_Execute"]


class GenerationClue(NamedTuple):
    """A clue to the generation of a controller.

    Attributes:
        strength: The stronger clue wins; 0 if there is no clue.
        generation: Generation that it points to.
        reason: Why, one clause.
    """

    strength: int
    generation: Generation | None
    reason: str


NO_CLUE = GenerationClue(0, None, "")

_RC7, _RC8 = Generation.RC7, Generation.RC8
_PROOF, _STRONG, _FAIR, _WEAK = 4, 3, 2, 1

_PROVIDERS = (
    # orin_bcap samples. NetwoRC is ORiN's provider for RC7, which nevertheless accepts any name.
    ("caoprov.denso.vrc", GenerationClue(_FAIR, _RC8, "the client asks for provider CaoProv.DENSO.VRC")),
    (
        "caoprov.denso.networc",
        GenerationClue(_FAIR, _RC7, "the client asks for provider CaoProv.DENSO.NetwoRC"),
    ),
)
_COMMANDS = {
    # DENSO Wave 2009, How to use the Slave mode; DENSORobot/denso_robot_ros2 denso_robot_core
    "slvsendformat": GenerationClue(_STRONG, _RC8, "it takes slvSendFormat, which RC7 does not have"),
    "slvrecvformat": GenerationClue(_STRONG, _RC8, "it takes slvRecvFormat, which RC7 does not have"),
    "takearm": GenerationClue(_FAIR, _RC8, "it takes TakeArm"),
    "putautomode": GenerationClue(_FAIR, _RC7, "it takes PutAutoMode"),
}


def stronger_clue(known: GenerationClue, found: GenerationClue) -> GenerationClue:
    """Return the stronger clue; of equal ones the known one."""
    return found if found.strength > known.strength else known


def clue_of_set_point(parameter: Variant) -> GenerationClue:
    """Return the clue in the numbers of a set point: RC8 and later take doubles, RC7 single precision."""
    value = parameter.value
    if parameter.vt == ARRAY | VT.VARIANT and isinstance(value, tuple) and value:
        first = value[0]
        vt = first.vt if isinstance(first, Variant) else 0
    else:
        vt = parameter.vt
    if vt == ARRAY | VT.R8:
        return GenerationClue(_STRONG, _RC8, "set points are VT_R8, as RC8 and later take them")
    if vt == ARRAY | VT.R4:
        return GenerationClue(_STRONG, _RC7, "set points are VT_R4, as RC7 takes them")
    return NO_CLUE


def clue_of_call(call: Call) -> GenerationClue:
    """Return the clue in any other successful call; `NO_CLUE` for most."""
    if call.reply is None or is_failure(call.reply.item.code):
        return NO_CLUE
    function_id, command = call.kind
    if function_id == _CONNECT:
        return _clue_of_provider(call.request.item.arguments)
    if function_id not in (_ROBOT_EXECUTE, _CONTROLLER_EXECUTE) or command is None:
        return NO_CLUE
    name = command.casefold()
    return _clue_of_change(call) if name == "slvchangemode" else _COMMANDS.get(name, NO_CLUE)


def _clue_of_provider(arguments: tuple[Argument, ...]) -> GenerationClue:
    value = arguments[1].variant.value if len(arguments) > 1 else None
    name = value.casefold() if isinstance(value, str) else ""
    return next((clue for beginning, clue in _PROVIDERS if name.startswith(beginning)), NO_CLUE)


def _clue_of_change(call: Call) -> GenerationClue:
    arguments = call.request.item.arguments
    parameter = arguments[2].variant if len(arguments) > 2 else Variant(VT.EMPTY, None)
    value = integer_value(parameter)
    if value and slave_mode_by_number(value, _RC8) and not slave_mode_by_number(value, _RC7):
        return GenerationClue(_PROOF, _RC8, f"it takes mode 0x{value:03X}, which RC7 does not have")
    result = call.reply.item.arguments if call.reply is not None else ()
    if result and result[0].variant.vt == VT.EMPTY:
        return GenerationClue(_FAIR, _RC8, "its reply to slvChangeMode holds an EMPTY, as from RC8 and later")
    if not result:
        return GenerationClue(_FAIR, _RC7, "its reply to slvChangeMode holds no argument, as from RC7")
    return (
        GenerationClue(_WEAK, _RC7, "the mode is sent as VT_I2, as to RC7")
        if parameter.vt == VT.I2
        else NO_CLUE
    )
