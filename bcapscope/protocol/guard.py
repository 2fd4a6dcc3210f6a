"""What one request can do to the robot, by its function and its arguments, and what must never be held up.

For arming a client and for a proxy that lets only reading pass. Careful by design: a command that is not in
the catalogue, an argument that is missing or of another type, or an id that is no function counts as moving.
"""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.protocol.commands import command
from bcapscope.protocol.effects import Effect, function_effect
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.slavemode import mode_value
from bcapscope.protocol.variant import Variant

_EXECUTES = frozenset(function.id for function in FUNCTIONS.values() if function.name.endswith("_Execute"))
_COMMAND_EXECUTE, _ROBOT_EXECUTE, _ROBOT_HALT = 112, 64, 70
_GETS_FILE = (6, 37)


def request_effect(function_id: int, arguments: Sequence[Variant]) -> Effect:
    """Return the most that a request can do.

    Args:
        function_id: of the request.
        arguments: of the request, the handle first.
    """
    if function_id in _EXECUTES and function_id != _COMMAND_EXECUTE:
        known = command(function_id, _text(arguments, 1) or "")
        return known.effect if known else Effect.MOVES
    if function_id in _GETS_FILE:
        option = _text(arguments, 2)
        creates_file = option is None or "@create" in option.casefold()
        return Effect.CHANGES if creates_file else Effect.SESSION
    return function_effect(function_id)


def always_passes(function_id: int, arguments: Sequence[Variant]) -> bool:
    """Tell whether a request stops the robot or lets go of something, so that no guard may hold it up.

    These are Robot_Halt, slvChangeMode 0, the releases, Controller_Disconnect and Service_Stop.
    """
    function = FUNCTIONS.get(function_id)
    if function is None:
        return False
    if function.releases is not None or function_id == _ROBOT_HALT:
        return True
    if function_id != _ROBOT_EXECUTE or len(arguments) < 3:
        return False
    return (_text(arguments, 1) or "").casefold() == "slvchangemode" and mode_value(arguments[2]) == 0


def passes_read_only(function_id: int, arguments: Sequence[Variant]) -> bool:
    """Tell whether a proxy that lets only reading pass may pass a request on.

    What opens a session passes, Controller_Connect too: nothing can be read without the handles that it
    gives, and all that it changes is that the controller has one more client.
    """
    return always_passes(function_id, arguments) or request_effect(function_id, arguments) <= Effect.SESSION


def _text(arguments: Sequence[Variant], index: int) -> str | None:
    value = arguments[index].value if index < len(arguments) else None
    return value if isinstance(value, str) else None
