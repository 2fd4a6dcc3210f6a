"""Convert Python values to VARIANTs and back."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from datetime import datetime, timedelta

from bcapscope.errors import LocalProtocolError
from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.variant import EMPTY, VT, Value, Variant, encode_variant
from bcapscope.protocol.tables.function_table import Function, Param

_DATE_ZERO = datetime(1899, 12, 30)
_TYPES = {"VT_I4": VT.I4, "VT_R4": VT.R4, "VT_BSTR": VT.BSTR}


def variant_of(value: object) -> Variant:
    """Convert a Python value to a VARIANT. Raise LocalProtocolError if b-CAP has no type for this value.

    None becomes EMPTY, bool BOOL, int I4 (or I8 if too large for I4), float R8, str BSTR, and bytes an array
    of UI1. A list of values of one type becomes an array of this type. A list of int and float becomes an
    array of R8. Any other list becomes an array of VARIANT. A Variant stays unchanged.
    """
    if isinstance(value, Variant):
        return value
    if value is None:
        return EMPTY
    if isinstance(value, bytes):
        return Variant.array(VT.UI1, value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return _array_variant(value)
    scalar = _scalar_variant(value)
    if scalar is None:
        raise LocalProtocolError(Message("value.no-type", type=type(value).__name__))
    return scalar


def arguments_of(function: Function, values: Sequence[object]) -> tuple[Variant, ...]:
    """Convert values to a request's arguments. Raise LocalProtocolError for a wrong number or wrong value."""
    if len(values) != len(function.params):
        wanted = Count(len(function.params), "argument")
        raise LocalProtocolError(
            Message("value.argument-count", function=function.name, wanted=wanted, given=len(values))
        )
    return tuple(
        argument_of(function, param, value) for param, value in zip(function.params, values, strict=True)
    )


def argument_of(function: Function, param: Param, value: object) -> Variant:
    """Convert a value to an argument. Raise LocalProtocolError if the value does not fit the argument's type.
    A Variant stays unchanged.
    """
    if isinstance(value, Variant) or param.type == "VARIANT":
        return variant_of(value)
    variant = Variant(_TYPES[param.type], value)  # type: ignore[arg-type]  # encode_variant checks the value
    try:
        encode_variant(variant)
    except LocalProtocolError:
        shown = reprlib.repr(value)
        wrong = Message(
            "value.wrong-type", function=function.name, param=param.name, value=shown, type=param.type
        )
        raise LocalProtocolError(wrong) from None
    return variant


def plain_value(variant: Variant) -> Value:
    if isinstance(variant.value, tuple):
        return tuple(plain_value(item) if isinstance(item, Variant) else item for item in variant.value)
    return variant.value


def date_of(days: float) -> datetime | None:
    """Convert a DATE to a datetime in the controller's time zone; None if datetime cannot represent it."""
    try:
        return _DATE_ZERO + timedelta(days=days)
    except (OverflowError, ValueError):
        return None


def _scalar_variant(value: object) -> Variant | None:
    match value:
        case bool():
            return Variant(VT.BOOL, value)
        case int():
            return Variant(VT.I4 if -(2**31) <= value < 2**31 else VT.I8, value)
        case float():
            return Variant(VT.R8, value)
        case str():
            return Variant(VT.BSTR, value)
    return None


def _array_variant(values: Sequence[object]) -> Variant:
    scalars = [scalar for scalar in map(_scalar_variant, values) if scalar is not None]
    types = {scalar.vt for scalar in scalars}
    if len(scalars) == len(values):
        numbers = tuple(scalar.value for scalar in scalars if isinstance(scalar.value, int | float))
        if VT.R8 in types and types <= {VT.I4, VT.I8, VT.R8}:
            return Variant.array(VT.R8, tuple(map(float, numbers)))
        if types == {VT.I4, VT.I8}:
            return Variant.array(VT.I8, numbers)
        if len(types) == 1:
            return Variant.array(types.pop(), tuple(scalar.value for scalar in scalars))
    return Variant.array(VT.VARIANT, tuple(map(variant_of, values)))
