"""The text notation of VARIANTs: `i2:2`, `r4[]:10,20,30`, or only a value if its type is known or guessed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import (
    ARRAY,
    EMPTY,
    NUMBER_FORMATS,
    NUMBER_WIDTHS,
    VT,
    Value,
    Variant,
    vt_name,
)
from bcapscope.protocol.text_format import shortened

_TYPED = re.compile(r"([a-z]+[0-9]?)(\[\])?:(.*)", re.IGNORECASE | re.DOTALL)
_LARGEST_R4 = 3.4028235e38
_LONGEST_SHOWN = 60  # maximum number of characters of a value that an error message quotes
_TRUE, _FALSE = ("true", "1", "-1"), ("false", "0")


def parse_variant(text: str) -> Variant:
    """Parse a type, a colon and a value. If the type and the colon are missing, guess the type.

    The types in lower or upper case are `i2 i4 r4 r8 cy date bstr error bool ui1 ui2 ui4 i8 ui8 empty null`.
    ``[]`` marks an array, whose elements are separated by commas. ``variant[]:`` takes elements separated by
    semicolons, each with its own type. A hexadecimal integer may be the bit pattern of a negative number, as
    in ``i4:0x84201482``. Text without a type becomes an integer, a number, a list of numbers, or a string.
    Empty text is EMPTY.

    Raises:
        InputError: The value does not fit the type.
    """
    match = _TYPED.fullmatch(text)
    vt = VT.__members__.get(match[1].upper()) if match else None
    if match and vt is not None:
        return _parse_array(vt, match[3]) if match[2] else _parse_scalar(vt, match[3])
    return _parse_untyped(text)


def parse_variant_as(text: str, types: Sequence[str]) -> Variant:
    """Parse a value of one of `types`, such as ``VT_I4`` or ``VT_R8|VT_ARRAY``.

    Text without a type gets the first type in `types` that fits, and VT_BSTR only if no other type fits. If
    the text begins with a type, as in ``i4:5``, this type replaces `types`. If `types` contains only VT_BSTR,
    the whole text is the value, even ``i4:5``.

    Raises:
        InputError: The text fits none of the types.
    """
    if tuple(types) == ("VT_BSTR",):
        return Variant(VT.BSTR, text)
    match = _TYPED.fullmatch(text)
    if match and match[1].upper() in VT.__members__:
        return parse_variant(text)
    known = [name for name in types if name in _BY_NAME]
    reasons = []
    for name in sorted(known, key="VT_BSTR".__eq__):
        try:
            parse, vt = _BY_NAME[name]
            return parse(vt, text)
        except ValueError as error:
            reasons.append(error)
    if reasons:
        raise reasons[0]
    return _parse_untyped(text)


def _parse_untyped(text: str) -> Variant:
    if not text:
        return EMPTY
    if not any(map(str.isdigit, text)):  # without a type, `nan` and `inf` are strings
        return Variant(VT.BSTR, text)
    for vt in (VT.I4, VT.I8, VT.R8):
        for read in (_parse_scalar, _parse_array) if "," in text else (_parse_scalar,):
            try:
                return read(vt, text)
            except ValueError:
                continue
    return Variant(VT.BSTR, text)


def _parse_scalar(vt: VT, text: str) -> Variant:
    if vt in (VT.EMPTY, VT.NULL):
        if text:
            raise InputError(Message("value.needless", type=vt_name(vt)))
        return Variant(vt, None)
    if vt is VT.VARIANT:
        raise InputError(Message("value.variant-array"))
    return Variant(vt, _parse_element(vt, text))


def _parse_array(vt: VT, text: str) -> Variant:
    if vt in (VT.EMPTY, VT.NULL):
        raise InputError(Message("value.no-arrays", type=vt_name(vt)))
    if vt is VT.VARIANT:
        return Variant.array(vt, tuple(parse_variant(piece) for piece in text.split(";")) if text else ())
    pieces = text.split(",") if text else []
    values = tuple(_parse_element(vt, piece if vt is VT.BSTR else piece.strip()) for piece in pieces)
    if vt is VT.UI1:
        return Variant.array(vt, bytes(value for value in values if isinstance(value, int)))
    return Variant.array(vt, values)


def _parse_element(vt: VT, text: str) -> Value:
    try:
        if vt is not VT.BSTR and not text.isascii():
            raise ValueError
        return _READERS.get(vt, _parse_integer)(vt, text)
    except ValueError:
        shown = repr(shortened(text, _LONGEST_SHOWN))
        raise InputError(Message("value.other-type", text=shown, type=vt_name(vt))) from None


def _parse_integer(vt: VT, text: str) -> int:
    try:
        value = int(text, 0)
    except ValueError:
        value = int(text)  # `int(text, 0)` rejects leading zeros
    low, high = _integer_range(vt)
    if high < value <= high - low and text.strip().lower().startswith("0x"):
        value -= high - low + 1  # the text may be the bit pattern of a negative number, such as a result code
    if not low <= value <= high:
        raise ValueError
    return value


def _parse_bool(_: VT, text: str) -> bool:
    word = text.casefold()
    if word not in _TRUE + _FALSE:
        raise ValueError
    return word in _TRUE


def _parse_float(vt: VT, text: str) -> float:
    value = float(text)
    if math.isinf(value) and "inf" not in text.lower():  # the number is too large for a float
        raise ValueError
    if vt is VT.R4 and math.isfinite(value) and abs(value) > _LARGEST_R4:
        raise ValueError
    return value


_READERS: dict[VT, Callable[[VT, str], Value]] = {
    VT.R4: _parse_float,
    VT.R8: _parse_float,
    VT.DATE: _parse_float,
    VT.BSTR: lambda _, text: text,
    VT.BOOL: _parse_bool,
}


def _integer_range(vt: VT) -> tuple[int, int]:
    bits = 8 * NUMBER_WIDTHS[vt]
    is_signed = NUMBER_FORMATS[vt].islower()
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if is_signed else (0, (1 << bits) - 1)


_BY_NAME = {
    vt_name(vt | flag): (parse, vt)
    for vt in VT
    for flag, parse in ((0, _parse_scalar), (ARRAY, _parse_array))
}
