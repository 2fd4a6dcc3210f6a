"""VARIANT: the typed values of b-CAP, their names and their encoding.

Layout of a VARIANT, all numbers little-endian: u16 type, u32 element count, data. In an argument of a frame,
the length of the VARIANT in bytes (u32) precedes the VARIANT. No length precedes the elements of a VARIANT
array (orin_bcap C/src/bcap_common.c, CSharp bCAPPacketConverter.cs and Python bcapclient.py).
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple, TypeAlias

from bcapscope.errors import LocalProtocolError
from bcapscope.messages import Message


class VT(IntEnum):
    """Types of VARIANTs in b-CAP, with the numbers of COM's VARENUM (orin_bcap C/include/bcap_common.h)."""

    EMPTY = 0
    NULL = 1
    I2 = 2
    I4 = 3
    R4 = 4
    R8 = 5
    CY = 6
    DATE = 7
    BSTR = 8
    ERROR = 10
    BOOL = 11
    VARIANT = 12
    UI1 = 17
    UI2 = 18
    UI4 = 19
    I8 = 20
    UI8 = 21


ARRAY = 0x2000
"""Flag that marks an array; it is or-ed with the type of the elements."""

NUMBER_FORMATS: dict[int, str] = {
    VT.I2: "h",
    VT.I4: "i",
    VT.R4: "f",
    VT.R8: "d",
    VT.CY: "q",
    VT.DATE: "d",
    VT.ERROR: "i",
    VT.BOOL: "h",
    VT.UI1: "B",
    VT.UI2: "H",
    VT.UI4: "I",
    VT.I8: "q",
    VT.UI8: "Q",
}
"""For each type of fixed width, the format character of Python's `struct` module."""

NUMBER_WIDTHS: dict[int, int] = {vt: struct.calcsize("<" + code) for vt, code in NUMBER_FORMATS.items()}
"""For each type of fixed width, the number of bytes per element."""

_NUMBERS = frozenset(NUMBER_FORMATS) - {VT.BOOL}

NUMBER_ARRAYS = frozenset(ARRAY | vt for vt in _NUMBERS - {VT.UI1})
"""Array types whose values are tuples of numbers."""

MAX_NESTING = 32
"""Maximum depth of nested VARIANT arrays, so that no frame exhausts the stack. Controllers nest two deep."""

CY_SCALE = 10_000
"""COM stores a CY value as a count of ten-thousandths, so 1.0 is stored as 10,000. `Variant` holds the raw
value, because DENSO's libraries do not scale CY values.
"""

Value: TypeAlias = "bool | int | float | str | bytes | tuple[Value, ...] | tuple[Variant, ...] | None"

_TYPE_COUNT = struct.Struct("<HI")
_NAMES = {int(vt): f"VT_{vt.name}" for vt in VT}


class Variant(NamedTuple):
    """A typed value.

    Attributes:
        vt: Type number; for an array, the flag `ARRAY` is added to the number. The number may be unknown in
            b-CAP.
        value: None for EMPTY and NULL. int, float, bool or str for scalars (CY and ERROR as raw integers,
            DATE as days since 1899-12-30). A tuple for arrays, `bytes` for an array of UI1, a tuple of
            Variant for an array of VARIANT. The undecoded `bytes` for an unknown type.
        elements: Element count in the frame: 1 for scalars, 0 or 1 for EMPTY and NULL. The count exceeds the
            number of values if elements are missing from the frame.
    """

    vt: int
    value: Value
    elements: int = 1

    @classmethod
    def array(cls, element: int, values: bytes | tuple[Value, ...] | tuple[Variant, ...]) -> Variant:
        """Return an array Variant whose elements have the type `element`."""
        return cls(ARRAY | element, values, len(values))


EMPTY = Variant(VT.EMPTY, None)


def vt_name(vt: int) -> str:
    """Return the name of a type: ``VT_I4``, ``VT_R8|VT_ARRAY``, or ``VT_0x0009`` for an unknown type."""
    base = _NAMES.get(vt & ~ARRAY) or f"VT_0x{vt & ~ARRAY:04X}"
    return f"{base}|VT_ARRAY" if vt & ARRAY else base


def integer_value(variant: Variant) -> int | None:
    """Return the whole number in a value, such as slvChangeMode's parameter or slvGetMode's result.

    Accepts integers of any width (VT_I2 in DENSO Wave 2009, VT_I4 in the samples), whole floating-point
    numbers, and decimal text of up to 9 digits, which the ANSI-C client sends. None for other values.
    """
    value = variant.value
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return int(value) if value.is_integer() else None
    if isinstance(value, str):
        text = value.strip()
        return int(text) if text.isascii() and text.isdecimal() and len(text) <= 9 else None
    return None


def encode_variant(variant: Variant) -> bytes:
    """Encode a VARIANT as type, element count and data. In an argument, a byte length precedes this encoding.

    Raises:
        LocalProtocolError: b-CAP has no such type, the value does not fit the type, an array's element count
            differs from its number of values, or arrays are nested deeper than `MAX_NESTING`.
    """
    return _encode(variant, 0)


def encode_argument(variant: Variant) -> bytes:
    """Encode an argument: a byte length (u32), then the VARIANT. Raise the errors of `encode_variant`."""
    body = _encode(variant, 0)
    return len(body).to_bytes(4, "little") + body


def _encode(variant: Variant, depth: int) -> bytes:
    try:
        vt, value, elements = variant
        if vt in _NUMBERS:
            return _packer(vt, 1)(vt, elements, value)
        if vt & ARRAY:
            _check_elements(value, elements)
            if vt in NUMBER_ARRAYS:
                return _packer(vt & ~ARRAY, elements)(vt, elements, *value)  # type: ignore[misc]  # checked
            return _TYPE_COUNT.pack(vt, elements) + _encode_array(vt & ~ARRAY, value, depth)
        return _TYPE_COUNT.pack(vt, elements) + _encode_scalar(vt, value)
    except (struct.error, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise LocalProtocolError(
            Message("value.not-packed", value=reprlib.repr(variant), reason=str(error))
        ) from error


@lru_cache(maxsize=256)
def _packer(vt: int, count: int) -> Callable[..., bytes]:
    return struct.Struct(f"<HI{count}{NUMBER_FORMATS[vt]}").pack


def _check_elements(values: Value, elements: int) -> None:
    if not isinstance(values, tuple | bytes):
        raise TypeError("the value of an array must be a tuple, or bytes for VT_UI1")
    if len(values) != elements:
        raise ValueError(f"element count is {elements}, but there are {len(values)} values")


def _encode_array(base: int, values: Value, depth: int) -> bytes:
    assert isinstance(values, tuple | bytes)
    if base == VT.UI1:
        return bytes(values)  # type: ignore[arg-type]  # bytes() itself rejects wrong elements
    if base == VT.BSTR:
        return b"".join(map(_encode_bstr, values))
    if base == VT.VARIANT:
        if depth == MAX_NESTING:
            raise ValueError(f"VARIANT arrays are nested more than {MAX_NESTING} deep")
        return b"".join(_encode(value, depth + 1) for value in values)  # type: ignore[arg-type]  # see VT.UI1
    if base == VT.BOOL:
        return b"".join(map(_encode_bool, values))
    raise ValueError(f"{vt_name(base)} is not a type of b-CAP")


def _encode_scalar(vt: int, value: Value) -> bytes:
    if vt == VT.BSTR:
        return _encode_bstr(value)
    if vt == VT.BOOL:
        return _encode_bool(value)
    if vt not in (VT.EMPTY, VT.NULL):
        raise ValueError(f"{vt_name(vt)} is not a type of b-CAP")
    if value is not None:
        raise TypeError(f"{vt_name(vt)} has no value")
    return b""


def _encode_bstr(value: Value | Variant) -> bytes:
    if not isinstance(value, str):
        raise TypeError("the value must be a string")
    data = value.encode("utf-16-le", "surrogatepass")
    return len(data).to_bytes(4, "little") + data


def _encode_bool(value: Value | Variant) -> bytes:
    return b"\xff\xff" if value else b"\x00\x00"
