"""Functions with which the rules read the arguments and the results of calls."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import Value, Variant
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call


def argument(call: Call, index: int) -> Variant | None:
    arguments = call.request.item.arguments
    return arguments[index].variant if index < len(arguments) else None


def text_argument(call: Call, index: int) -> str:
    variant = argument(call, index)
    return variant.value if variant is not None and isinstance(variant.value, str) else ""


def result_of(call: Call) -> Value:
    """Return the value of the reply; None if the call failed, or if the reply has no value."""
    if call.reply is None or is_failure(call.reply.item.code) or not call.reply.item.arguments:
        return None
    return call.reply.item.arguments[0].variant.value


def first_number(variant: Variant | None) -> int | None:
    """Return the integer in an argument: a number, the first element of an array, or a text of digits."""
    value = variant.value if variant is not None else None
    if isinstance(value, tuple):
        first = value[0] if value else None
        value = first.value if isinstance(first, Variant) else first
    if isinstance(value, str):
        return int(value) if value.isascii() and value.isdecimal() and len(value) <= 9 else None
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else None


def requested_motor_state(call: Call) -> bool | None:
    """Return whether a call switches the motor on; None if the argument is unreadable."""
    if call.kind.function_id == ID["Variable_PutValue"]:
        value = argument(call, 1)
        return None if value is None or not isinstance(value.value, int) else bool(value.value)
    state = first_number(argument(call, 2))
    return None if state is None else bool(state)


def gets_robslave(call: Call) -> bool:
    """Return whether a call gets a handle for the task RobSlave, which must run for slave mode on an RC7."""
    return call.kind.function_id == ID["Controller_GetTask"] and is_robslave_name(text_argument(call, 1))


def is_robslave_name(name: str) -> bool:
    return name.casefold().removesuffix(".pac") == "robslave"
