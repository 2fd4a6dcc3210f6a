"""VARIANTs packed: a table of values and bytes, names, and everything that b-CAP cannot express."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.errors import LocalProtocolError
from bcapscope.protocol.codec.variant import (
    ARRAY,
    EMPTY,
    MAX_NESTING,
    VT,
    Variant,
    encode_argument,
    encode_variant,
    integer_value,
    vt_name,
)
from tests.frames import ARGUMENT_IDS, ARGUMENTS, ArgumentPair


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_packs_as_the_table_says(pair: ArgumentPair) -> None:
    assert encode_argument(pair.variant).hex() == pair.data.hex()
    assert encode_variant(pair.variant) == pair.data[4:]


def test_every_type_is_in_the_table_alone_and_as_array() -> None:
    carried = {pair.variant.vt for pair in ARGUMENTS}
    no_array = {VT.EMPTY, VT.NULL}
    assert carried >= {int(vt) for vt in VT if vt != VT.VARIANT}
    assert carried >= {ARRAY | vt for vt in VT if vt not in no_array}


def test_array_counts_its_values() -> None:
    assert Variant.array(VT.R8, (1.0, 2.0)) == Variant(0x2005, (1.0, 2.0), 2)
    assert Variant(0, None, 1) == EMPTY


def test_a_scalar_goes_out_with_the_count_it_is_given() -> None:
    assert encode_variant(Variant(VT.I2, 5, 3)).hex() == "0200030000000500"


def test_elements_of_a_bool_array_are_minus_one_or_zero() -> None:
    assert encode_variant(Variant.array(VT.BOOL, (1, 0))).hex() == "0b2002000000ffff0000"


def test_a_ui1_array_takes_a_tuple_too() -> None:
    assert encode_variant(Variant.array(VT.UI1, (1, 255))).hex() == "11200200000001ff"


def _nested(depth: int) -> Variant:
    variant = Variant.array(VT.VARIANT, ())
    for _ in range(depth - 1):
        variant = Variant.array(VT.VARIANT, (variant,))
    return variant


def test_nests_as_deep_as_is_read() -> None:
    assert len(encode_variant(_nested(MAX_NESTING))) == 6 * MAX_NESTING
    assert len(encode_argument(_nested(MAX_NESTING))) == 6 * MAX_NESTING + 4


@pytest.mark.parametrize(
    "variant",
    [
        Variant(VT.I2, 32768),
        Variant(VT.I2, 1.5),
        Variant(VT.I4, "1"),
        Variant(VT.UI1, -1),
        Variant(VT.UI8, 2**64),
        Variant(VT.R4, 1e39),
        Variant(VT.R8, "x"),
        Variant(VT.R8, None),
        Variant(VT.R8, 10**400),
        Variant(VT.BSTR, None),
        Variant(VT.BSTR, b"A"),
        Variant(VT.EMPTY, 0),
        Variant(VT.NULL, ""),
        Variant(VT.VARIANT, 1),
        Variant(9, b"\x00"),
        Variant(0x4003, 1),
        Variant(-1, 1),
        Variant(0x10003, 1),
        Variant(VT.I4, 1, -1),
        Variant(VT.I4, 1, 2**32),
        Variant("VT_I4", 1),  # type: ignore[arg-type]
        Variant(ARRAY | VT.I4, 7),
        Variant(ARRAY | VT.I4, (1, 2)),
        Variant(ARRAY | VT.I4, (1, 2), 3),
        Variant.array(VT.I4, (1, "2")),
        Variant.array(VT.UI1, (256,)),
        Variant.array(VT.UI1, ("a",)),
        Variant.array(VT.BSTR, ("a", 1)),
        Variant.array(VT.VARIANT, (1,)),
        Variant.array(VT.VARIANT, (Variant(VT.I2, 70000),)),
        Variant.array(VT.EMPTY, ()),
        Variant.array(9, ()),
    ],
    ids=lambda variant: f"{variant.vt} {variant.value!r}"[:40],
)
def test_refuses_what_cannot_be_expressed(variant: Variant) -> None:
    with pytest.raises(LocalProtocolError):
        encode_argument(variant)


@pytest.mark.parametrize("depth", [MAX_NESTING + 1, 2000])
def test_refuses_to_nest_deeper_than_is_read(depth: int) -> None:
    for encode in (encode_argument, encode_variant):
        with pytest.raises(LocalProtocolError, match="nested more than 32 deep"):
            encode(_nested(depth))


def test_a_refusal_is_short_however_large_the_value() -> None:
    with pytest.raises(LocalProtocolError, match=r"cannot be packed") as refusal:
        encode_variant(Variant(VT.I4, "x" * 100_000))
    assert len(str(refusal.value)) < 300


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | st.binary(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=3).map(tuple)
        | st.builds(Variant, st.integers(-1, 0x3000), inner, st.integers(-1, 4))
    ),
    max_leaves=6,
)


@given(st.integers(0, 25) | st.integers(0x2000, 0x2020) | st.integers(), ANYTHING, st.integers(-1, 2**32))
def test_refuses_with_one_error_only(vt: int, value: object, elements: int) -> None:
    try:
        packed = encode_argument(Variant(vt, value, elements))  # type: ignore[arg-type]
    except LocalProtocolError:
        return
    assert packed[:4] == (len(packed) - 4).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("vt", "name"),
    [
        (0, "VT_EMPTY"),
        (3, "VT_I4"),
        (0x2005, "VT_R8|VT_ARRAY"),
        (0x200C, "VT_VARIANT|VT_ARRAY"),
        (9, "VT_0x0009"),
        (0x2009, "VT_0x0009|VT_ARRAY"),
        (0x4003, "VT_0x4003"),
        (0x6003, "VT_0x4003|VT_ARRAY"),
    ],
)
def test_types_have_names(vt: int, name: str) -> None:
    assert vt_name(vt) == name


@pytest.mark.parametrize(
    ("parameter", "value"),
    [
        (Variant(VT.I2, 0x102), 0x102),
        (Variant(VT.I4, 514), 0x202),
        (Variant(VT.BSTR, "514"), 0x202),
        (Variant(VT.BSTR, " 0 "), 0),
        (Variant(VT.R8, 2.0), 2),
        (Variant(VT.R8, 2.5), None),
        (Variant(VT.R8, float("nan")), None),
        (Variant(VT.R8, float("inf")), None),
        (Variant(VT.BOOL, False), None),
        (Variant(VT.BSTR, ""), None),
        (Variant(VT.BSTR, "123456789"), 123_456_789),
        (Variant(VT.BSTR, "1234567890"), None),
        (Variant(VT.BSTR, "９" * 4), None),
        (Variant(VT.BSTR, "9" * 5000), None),
        (EMPTY, None),
        (Variant.array(VT.I4, (2,)), None),
    ],
)
def test_an_integer_is_read_from_any_type_that_clients_send(parameter: Variant, value: int | None) -> None:
    assert integer_value(parameter) == value
