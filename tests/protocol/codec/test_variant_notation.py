"""What people type, and the VARIANT that it stands for."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, encode_variant
from bcapscope.protocol.codec.variant_notation import parse_variant, parse_variant_as

_MIXED = (Variant(VT.I4, 1), Variant.array(VT.R8, (1.0, 2.5)), Variant(VT.BSTR, "@P"))


@pytest.mark.parametrize(
    ("text", "variant"),
    [
        ("i2:2", Variant(VT.I2, 2)),
        ("I4:-0x10", Variant(VT.I4, -16)),
        ("i4:0x84201482", Variant(VT.I4, 0x84201482 - 2**32)),
        ("0xFFFFFFFF", Variant(VT.I4, -1)),
        ("i2[]:0x7fff,0x8000", Variant.array(VT.I2, (32767, -32768))),
        ("r4[]:10, 20,30", Variant.array(VT.R4, (10.0, 20.0, 30.0))),
        ("r8[]:", Variant.array(VT.R8, ())),
        ("ui1[]:1,255", Variant.array(VT.UI1, b"\x01\xff")),
        ("bstr:a:b,c", Variant(VT.BSTR, "a:b,c")),
        ("bstr:日本", Variant(VT.BSTR, "日本")),
        ("r8:1e39", Variant(VT.R8, 1e39)),
        ("r8:-inf", Variant(VT.R8, float("-inf"))),
        ("r4:3.4028235e38", Variant(VT.R4, 3.4028235e38)),
        ("r4:inf", Variant(VT.R4, float("inf"))),
        ("ui1:0xff", Variant(VT.UI1, 255)),
        ("bstr[]:a, b", Variant.array(VT.BSTR, ("a", " b"))),
        ("bool:True", Variant(VT.BOOL, True)),
        ("bool[]:1,0", Variant.array(VT.BOOL, (True, False))),
        ("empty:", EMPTY),
        ("null:", Variant(VT.NULL, None)),
        ("date:25569.5", Variant(VT.DATE, 25569.5)),
        ("variant[]:i4:1;r8[]:1,2.5;@P", Variant.array(VT.VARIANT, _MIXED)),
        ("variant[]:", Variant.array(VT.VARIANT, ())),
        ("", EMPTY),
        ("7", Variant(VT.I4, 7)),
        ("3000000000", Variant(VT.I8, 3_000_000_000)),
        ("1.5", Variant(VT.R8, 1.5)),
        ("007", Variant(VT.I4, 7)),
        ("i2:-08", Variant(VT.I2, -8)),
        ("nan", Variant(VT.BSTR, "nan")),
        ("Infinity", Variant(VT.BSTR, "Infinity")),
        ("1,2", Variant.array(VT.I4, (1, 2))),
        ("1,2.5", Variant.array(VT.R8, (1.0, 2.5))),
        ("@E J(0,0,90)", Variant(VT.BSTR, "@E J(0,0,90)")),
        ("http://x", Variant(VT.BSTR, "http://x")),
    ],
)
def test_values(text: str, variant: Variant) -> None:
    assert parse_variant(text) == variant


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("i2:70000", "'70000' is not a VT_I2"),
        ("i2:１２", "'１２' is not a VT_I2"),
        ("r8:1e999", "'1e999' is not a VT_R8"),
        ("r4:1e39", "'1e39' is not a VT_R4"),
        ("r4:-1e39", "'-1e39' is not a VT_R4"),
        ("ui1:-1", "'-1' is not a VT_UI1"),
        ("ui1:0x100", "'0x100' is not a VT_UI1"),
        ("i2:0x10000", "'0x10000' is not a VT_I2"),
        ("r4[]:1,,2", "'' is not a VT_R4"),
        ("bool:2", "'2' is not a VT_BOOL"),
        ("empty:1", "VT_EMPTY has no value"),
        ("empty[]:1", "arrays of VT_EMPTY do not exist"),
        ("variant:1", "always an array"),
    ],
)
def test_what_does_not_go_with_its_type(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_variant(text)


@pytest.mark.parametrize(
    ("vt", "low", "high"),
    [
        (VT.I2, -(2**15), 2**15 - 1),
        (VT.I4, -(2**31), 2**31 - 1),
        (VT.ERROR, -(2**31), 2**31 - 1),
        (VT.I8, -(2**63), 2**63 - 1),
        (VT.CY, -(2**63), 2**63 - 1),
        (VT.UI1, 0, 2**8 - 1),
        (VT.UI2, 0, 2**16 - 1),
        (VT.UI4, 0, 2**32 - 1),
        (VT.UI8, 0, 2**64 - 1),
    ],
)
def test_the_ends_of_each_integer_type(vt: VT, low: int, high: int) -> None:
    for value in (low, high):
        assert parse_variant(f"{vt.name}:{value}") == Variant(vt, value)
    for value in (low - 1, high + 1):
        with pytest.raises(ValueError, match=f"'{value}' is not a VT_{vt.name}"):
            parse_variant(f"{vt.name}:{value}")


@pytest.mark.parametrize(
    ("text", "types", "variant"),
    [
        ("2", ["VT_I2", "VT_I4"], Variant(VT.I2, 2)),
        ("i4:2", ["VT_I2"], Variant(VT.I4, 2)),
        ("1,0", ["VT_BSTR", "VT_I4", "VT_I4|VT_ARRAY"], Variant.array(VT.I4, (1, 0))),
        ("on", ["VT_I4", "VT_BSTR"], Variant(VT.BSTR, "on")),
        ("", ["VT_I4|VT_ARRAY", "VT_EMPTY"], Variant.array(VT.I4, ())),
        ("", ["VT_EMPTY", "VT_BSTR"], EMPTY),
        ("i4:2", ["VT_BSTR"], Variant(VT.BSTR, "i4:2")),
        ("2", ["VARIANT"], Variant(VT.I4, 2)),
        ("1,2,3", ["VT_R4|VT_ARRAY"], Variant.array(VT.R4, (1.0, 2.0, 3.0))),
    ],
)
def test_types_that_are_known(text: str, types: list[str], variant: Variant) -> None:
    assert parse_variant_as(text, types) == variant


def test_none_of_the_known_types() -> None:
    with pytest.raises(ValueError, match="'x' is not a VT_I2"):
        parse_variant_as("x", ["VT_I2", "VT_I4"])


@given(st.text(), st.sampled_from(["", *(f"{vt.name}:" for vt in VT), *(f"{vt.name}[]:" for vt in VT)]))
def test_what_is_read_can_be_sent(text: str, prefix: str) -> None:
    try:
        variant = parse_variant(prefix + text)
    except ValueError:
        return
    if variant.vt & 0xFF != VT.R4:  # a number may be too large for it
        encode_variant(variant)
