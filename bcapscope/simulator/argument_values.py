"""Functions that make VARIANT values, and functions that read a client's values leniently."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress

from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError

LARGEST_FLOAT = 3.4028234663852886e38


def i2(number: int) -> Variant:
    return Variant(VT.I2, _signed(number, 16))


def i4(number: int) -> Variant:
    return Variant(VT.I4, _signed(number, 32))


def r4(number: float) -> Variant:
    return Variant(VT.R4, clip_to_r4(number))


def r8(number: float) -> Variant:
    return Variant(VT.R8, float(number))


def bstr(text: str) -> Variant:
    return Variant(VT.BSTR, text)


def boolean(value: bool) -> Variant:
    return Variant(VT.BOOL, value)


def float_array(element: VT, values: Iterable[float]) -> Variant:
    numbers = tuple(map(clip_to_r4, values)) if element == VT.R4 else tuple(map(float, values))
    return Variant.array(element, numbers)


def variant_array(*items: Variant) -> Variant:
    return Variant.array(VT.VARIANT, items)


def bstr_array(items: Iterable[str]) -> Variant:
    return Variant.array(VT.BSTR, tuple(items))


def clip_to_r4(number: float) -> float:
    if math.isfinite(number):
        return max(-LARGEST_FLOAT, min(LARGEST_FLOAT, float(number)))
    return float(number)


def _signed(number: int, bits: int) -> int:
    low = number & (1 << bits) - 1
    return low - (1 << bits) if low >> bits - 1 else low


def number_of(variant: Variant) -> float | int:
    """Read a number, a decimal text or the first number of an array; refuse a call without a number."""
    found = _plain(variant.value)
    if isinstance(found, tuple | bytes) and found:
        found = _plain(found[0])
    if isinstance(found, str) and len(found) <= 40:
        with suppress(ValueError):
            found = float(found)
    if isinstance(found, int | float) and math.isfinite(found):
        return found
    raise RefusedError(RefusalCode.TYPE_MISMATCH)


def integer_of(variant: Variant) -> int:
    return int(number_of(variant))


def number_within(variant: Variant, allowed: range, refusal: int) -> int:
    number = integer_of(variant)
    if number not in allowed:
        raise RefusedError(refusal)
    return number


def text_of(variant: Variant) -> str:
    """Return the text of a VARIANT, "" for EMPTY and NULL; refuse any other value."""
    if variant.value is None:
        return ""
    if isinstance(variant.value, str):
        return variant.value
    raise RefusedError(E_INVALIDARG)


def items_of(variant: Variant) -> Arguments:
    """Return the elements of an array; a scalar gives one element, and EMPTY gives none."""
    value = variant.value
    if value is None:
        return Arguments()
    if not isinstance(value, tuple | bytes):
        return Arguments((variant,))
    base = variant.vt & ~ARRAY
    return Arguments(item if isinstance(item, Variant) else Variant(base, item) for item in value)


def numbers_of(variant: Variant) -> tuple[float, ...]:
    return tuple(float(number_of(item)) for item in items_of(variant))


class Arguments(tuple[Variant, ...]):
    """Arguments of a call, or elements of a parameter. The methods refuse a call that lacks an argument."""

    __slots__ = ()

    def at(self, index: int) -> Variant:
        if index >= len(self):
            raise RefusedError(E_INVALIDARG)
        return self[index]

    def number(self, index: int) -> float:
        return float(number_of(self.at(index)))

    def integer(self, index: int, default: int | None = None) -> int:
        if default is not None and index >= len(self):
            return default
        return integer_of(self.at(index))

    def text(self, index: int, default: str | None = None) -> str:
        if default is not None and index >= len(self):
            return default
        return text_of(self.at(index))


def _plain(value: Value) -> Value:
    return value.value if isinstance(value, Variant) else value
