"""What is written as notation is read back as the same."""

from __future__ import annotations

import pytest
from hypothesis import given

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, encode_variant
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.render.value_text import typed_text, untyped_text
from tests.strategies import variants

CASES = [
    (Variant(VT.I2, 2), "i2:2"),
    (Variant(VT.I4, -5), "i4:-5"),
    (Variant(VT.BSTR, "@P P1, x;y"), "bstr:@P P1, x;y"),
    (Variant(VT.BOOL, True), "bool:true"),
    (EMPTY, "empty:"),
    (Variant.array(VT.R4, (12.422607421875, 0.5)), "r4[]:12.422607,0.5"),
    (Variant.array(VT.UI1, b"\x01\xff"), "ui1[]:1,255"),
    (
        Variant.array(VT.VARIANT, (Variant.array(VT.R8, (1.0, 2.0)), Variant(VT.BSTR, "J"))),
        "variant[]:r8[]:1.0,2.0;bstr:J",
    ),
]


@pytest.mark.parametrize(("variant", "text"), CASES, ids=[text for _, text in CASES])
def test_text(variant: Variant, text: str) -> None:
    assert typed_text(variant) == text


@pytest.mark.parametrize(
    "variant",
    [
        Variant.array(VT.BSTR, ("a,b", "c")),
        Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, (EMPTY, EMPTY)),)),
        Variant.array(VT.VARIANT, (Variant(VT.BSTR, "a;b"),)),
        Variant(0x0009, b"?"),
    ],
)
def test_what_cannot_be_typed_is_none(variant: Variant) -> None:
    assert typed_text(variant) is None
    assert untyped_text(variant) is None


@given(variants())
def test_what_is_written_reads_back(variant: Variant) -> None:
    text = typed_text(variant)
    if text is not None:
        assert encode_variant(parse_variant(text)) == encode_variant(variant)
