"""Infer the generation of a controller from the traffic.

The same number stands for different slave modes in different generations, and no frame names the generation.
"""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.messages.places import HexNumber
from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant, integer_value
from bcapscope.protocol.slave_mode.modes import Generation, slave_mode_by_number
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call

_CONNECT = ID["Controller_Connect"]
_ROBOT_EXECUTE = ID["Robot_Execute"]
_CONTROLLER_EXECUTE = ID["Controller_Execute"]


class GenerationClue(NamedTuple):
    """Evidence in the traffic for the generation of a controller. Strength 0 means no evidence."""

    strength: int
    generation: Generation | None
    reason: Message | None


NO_CLUE = GenerationClue(0, None, None)

_RC7, _RC8 = Generation.RC7, Generation.RC8
_PROOF, _STRONG, _FAIR, _WEAK = 4, 3, 2, 1

ENOUGH_TO_OBJECT = _FAIR
"""VT_R4 set points are reported only if a clue of at least this strength shows an RC8."""

# Source: the samples in orin_bcap. The provider is no proof, because an RC7 accepts any provider name.
_PROVIDERS = {"CaoProv.DENSO.VRC": _RC8, "CaoProv.DENSO.NetwoRC": _RC7}

_COMMANDS = {
    # DENSO Wave 2009, How to use the Slave mode; DENSORobot/denso_robot_ros2 denso_robot_core
    "slvsendformat": GenerationClue(
        _STRONG, _RC8, Message("generation.command.not-rc7", command="slvSendFormat")
    ),
    "slvrecvformat": GenerationClue(
        _STRONG, _RC8, Message("generation.command.not-rc7", command="slvRecvFormat")
    ),
    "takearm": GenerationClue(_WEAK, _RC8, Message("generation.command", command="TakeArm")),
    "putautomode": GenerationClue(_FAIR, _RC7, Message("generation.command", command="PutAutoMode")),
}


def stronger_clue(known: GenerationClue, found: GenerationClue) -> GenerationClue:
    """Return the stronger clue, or the earlier clue if both are equally strong."""
    return found if found.strength > known.strength else known


def clue_of_set_point(parameter: Variant) -> GenerationClue:
    """Return what the number type of a set point shows about the controller's generation. RC8 and later take
    double precision; RC7 takes single precision.
    """
    value = parameter.value
    if parameter.vt == ARRAY | VT.VARIANT and isinstance(value, tuple) and value:
        first = value[0]
        vt = first.vt if isinstance(first, Variant) else 0
    else:
        vt = parameter.vt
    if vt == ARRAY | VT.R8:
        return GenerationClue(_STRONG, _RC8, Message("generation.set-points.vt-r8"))
    if vt == ARRAY | VT.R4:
        return GenerationClue(_STRONG, _RC7, Message("generation.set-points.vt-r4"))
    return NO_CLUE


def clue_of_call(call: Call) -> GenerationClue:
    """Return what a call shows about the controller's generation. For set points, see `clue_of_set_point`."""
    if call.reply is None or is_failure(call.reply.item.code):
        return NO_CLUE
    function_id, command = call.kind
    if function_id == _CONNECT:
        return _clue_of_provider(call.request.item.arguments)
    if function_id not in (_ROBOT_EXECUTE, _CONTROLLER_EXECUTE) or command is None:
        return NO_CLUE
    name = call.kind.folded_command
    return _clue_of_change(call) if name == "slvchangemode" else _COMMANDS.get(name, NO_CLUE)


def _clue_of_provider(arguments: tuple[Argument, ...]) -> GenerationClue:
    value = arguments[1].variant.value if len(arguments) > 1 else None
    name = value.casefold() if isinstance(value, str) else ""
    for provider, generation in _PROVIDERS.items():
        if name.startswith(provider.casefold()):
            return GenerationClue(_FAIR, generation, Message("generation.provider", provider=provider))
    return NO_CLUE


def _clue_of_change(call: Call) -> GenerationClue:
    parameter = command_parameter(call.request.item.variants) or EMPTY
    value = integer_value(parameter)
    if value and slave_mode_by_number(value, _RC8) and not slave_mode_by_number(value, _RC7):
        return GenerationClue(_PROOF, _RC8, Message("generation.mode.not-rc7", mode=HexNumber(value, 3)))
    result = call.reply.item.arguments if call.reply is not None else ()
    if result and result[0].variant.vt == VT.EMPTY:
        return GenerationClue(_FAIR, _RC8, Message("generation.reply.empty"))
    if not result:
        return GenerationClue(_FAIR, _RC7, Message("generation.reply.no-argument"))
    if parameter.vt == VT.I2:
        return GenerationClue(_WEAK, _RC7, Message("generation.mode.vt-i2"))
    return NO_CLUE
