"""Decide from a request's function and arguments how the request affects the robot, and whether it is a stop.

bcapscope's clients and the proxy's guard use these functions. The functions assume that a request moves the
robot if its function id or command is unknown, or if an argument is missing or has a wrong type.
"""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.protocol.codec.variant import Variant, integer_value
from bcapscope.protocol.tables.call_effect import CallEffect, function_effect
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS, command_name, find_command
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID
from bcapscope.protocol.tables.variables import write_effect

_ROBOT_EXECUTE = ID["Robot_Execute"]
_PUT_VALUE = ID["Variable_PutValue"]
_GETS_FILE = (ID["Controller_GetFile"], ID["File_GetFile"])

_STOPPING_FUNCTIONS = frozenset(
    (ID["Robot_Halt"], ID["Robot_Hold"], ID["Task_Stop"], ID["Command_Cancel"]),
)
_STOPPING_COMMANDS = frozenset(("handstop", "twofgstop"))
_SWITCH_COMMANDS = frozenset(("motor", "slvchangemode"))
"""Commands that switch the motor or slave mode off if their parameter is 0."""

_ARGUMENTS_WITH_PARAMETER = 3
"""Number of arguments of a function such as Robot_Execute: handle, command, parameter."""


def request_effect(function_id: int, arguments: Sequence[Variant], variable: str = "") -> CallEffect:
    """Return the strongest effect that a request can have.

    `variable` is the name of the variable to which the handle refers; "" if unknown.
    """
    if function_id == _PUT_VALUE:
        return write_effect(variable, arguments[1]) if len(arguments) == 2 else CallEffect.MOVES
    if function_id in COMMAND_FUNCTIONS:
        return _command_effect(function_id, arguments)
    if function_id in _GETS_FILE:
        option = arguments[2].value if len(arguments) > 2 else None
        creates_file = not isinstance(option, str) or "@create" in option.casefold()
        return CallEffect.CHANGES if creates_file else CallEffect.SESSION
    return function_effect(function_id)


def always_passes(function_id: int, arguments: Sequence[Variant]) -> bool:
    """Return whether a request stops something or releases a handle, so that no guard may block it.

    Such requests are Robot_Halt, Robot_Hold, Task_Stop, Command_Cancel, HandStop, TwofgStop, slvChangeMode 0,
    the ..._Release functions, Controller_Disconnect and Service_Stop. If a stop has too many arguments, a
    guard may block this stop, because it is unclear which arguments the controller uses.
    """
    function = FUNCTIONS.get(function_id)
    if function is None:
        return False
    if function.releases is not None or function_id in _STOPPING_FUNCTIONS:
        return True
    command = command_name(function_id, arguments)
    if command is None or len(arguments) > _ARGUMENTS_WITH_PARAMETER:
        return False
    name = command.casefold()
    if name in _STOPPING_COMMANDS:
        return find_command(function_id, name) is not None
    return function_id == _ROBOT_EXECUTE and name == "slvchangemode" and _switches_off(name, arguments)


def passes_read_only(function_id: int, arguments: Sequence[Variant]) -> bool:
    """Return whether a read-only proxy forwards a request.

    A read-only proxy also forwards requests that open a session or an object, such as Controller_Connect. To
    read data, a client needs the handles that Controller_Connect and similar requests return.
    """
    return (
        always_passes(function_id, arguments) or request_effect(function_id, arguments) <= CallEffect.SESSION
    )


def needs_arming(function_id: int, arguments: Sequence[Variant], variable: str = "") -> bool:
    """Return whether bcapscope needs the user's confirmation (arming) to send a request to a real controller.

    Requests that may energise or move the robot need arming. Requests that stop something need no arming.
    `variable` is the name of the variable to which the handle refers; "" if unknown.
    """
    if always_passes(function_id, arguments):
        return False
    return request_effect(function_id, arguments, variable) >= CallEffect.ENERGISES


def _command_effect(function_id: int, arguments: Sequence[Variant]) -> CallEffect:
    known = find_command(function_id, command_name(function_id, arguments) or "")
    if known is None:
        return CallEffect.MOVES
    name = known.name.casefold()
    switches_off = name in _SWITCH_COMMANDS and _switches_off(name, arguments)
    return CallEffect.CHANGES if switches_off else known.effect


def _switches_off(command: str, arguments: Sequence[Variant]) -> bool:
    """Return whether the parameter of Motor or slvChangeMode is certainly 0. For Motor, the parameter may
    also be an array whose first element is 0.
    """
    if len(arguments) != _ARGUMENTS_WITH_PARAMETER:
        return False
    parameter = arguments[2]
    if isinstance(parameter.value, tuple):
        if command != "motor" or not parameter.value:
            return False
        first = parameter.value[0]
        parameter = first if isinstance(first, Variant) else Variant(parameter.vt, first)
    return integer_value(parameter) == 0
