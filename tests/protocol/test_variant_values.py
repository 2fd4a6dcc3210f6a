"""Python values as VARIANTs and back."""

from __future__ import annotations

from datetime import datetime

import pytest

from bcapscope.errors import LocalProtocolError
from bcapscope.protocol.codec.variant import EMPTY, VT, Value, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.variant_values import arguments_of, date_of, plain_value, variant_of

_I4 = Variant(VT.I4, 1)


@pytest.mark.parametrize(
    ("value", "variant"),
    [
        (None, EMPTY),
        (True, Variant(VT.BOOL, True)),
        (-5, Variant(VT.I4, -5)),
        (2**31 - 1, Variant(VT.I4, 2**31 - 1)),
        (2**31, Variant(VT.I8, 2**31)),
        (-(2**31), Variant(VT.I4, -(2**31))),
        (-(2**31) - 1, Variant(VT.I8, -(2**31) - 1)),
        (0.5, Variant(VT.R8, 0.5)),
        ("text", Variant(VT.BSTR, "text")),
        (b"\x01", Variant.array(VT.UI1, b"\x01")),
        ([1, 2], Variant.array(VT.I4, (1, 2))),
        ([1, 2**40], Variant.array(VT.I8, (1, 2**40))),
        ([1, 2.5], Variant.array(VT.R8, (1.0, 2.5))),
        ([1, 2**40, 2.5], Variant.array(VT.R8, (1.0, float(2**40), 2.5))),
        (("a", "b"), Variant.array(VT.BSTR, ("a", "b"))),
        ([True], Variant.array(VT.BOOL, (True,))),
        ([], Variant.array(VT.VARIANT, ())),
        ([True, 1], Variant.array(VT.VARIANT, (Variant(VT.BOOL, True), _I4))),
        ([[1], "a"], Variant.array(VT.VARIANT, (Variant.array(VT.I4, (1,)), Variant(VT.BSTR, "a")))),
        ([None], Variant.array(VT.VARIANT, (EMPTY,))),
        (Variant(VT.I2, 1), Variant(VT.I2, 1)),
    ],
)
def test_types_are_chosen(value: object, variant: Variant) -> None:
    assert variant_of(value) == variant


def test_what_has_no_type() -> None:
    with pytest.raises(LocalProtocolError, match="no type for a dict"):
        variant_of({})


def test_the_function_has_its_types() -> None:
    speed = FUNCTIONS[74]
    assert arguments_of(speed, (7, -1, 50)) == (Variant(VT.I4, 7), Variant(VT.I4, -1), Variant(VT.R4, 50))
    typed = Variant(VT.I2, 1)
    assert arguments_of(FUNCTIONS[64], (7, "Motor", typed))[2] is typed
    assert arguments_of(FUNCTIONS[64], (7, "Motor", 5))[2] == Variant(VT.I4, 5)
    assert arguments_of(speed, (7, typed, 50))[1] is typed


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ((7, "a", 1), "Robot_Speed, lAxis: 'a' is not a VT_I4"),
        ((7, 2**31, 1), "Robot_Speed, lAxis: 2147483648 is not a VT_I4"),
        ((None, 1, 1), "Robot_Speed, hRobot: None is not a VT_I4"),
        ((7, 1, "fast"), "Robot_Speed, fSpeed: 'fast' is not a VT_R4"),
    ],
)
def test_an_argument_of_another_type_is_named(values: tuple[object, ...], told: str) -> None:
    with pytest.raises(LocalProtocolError, match=told):
        arguments_of(FUNCTIONS[74], values)


@pytest.mark.parametrize(
    ("variant", "value"),
    [
        (EMPTY, None),
        (_I4, 1),
        (Variant.array(VT.UI1, b"\x01"), b"\x01"),
        (Variant.array(VT.VARIANT, (Variant.array(VT.R8, (1.0,)), _I4)), ((1.0,), 1)),
    ],
)
def test_values_without_types(variant: Variant, value: Value) -> None:
    assert plain_value(variant) == value


def test_dates() -> None:
    assert date_of(25569.25) == datetime(1970, 1, 1, 6)
    assert date_of(1e300) is None
    assert date_of(float("nan")) is None
