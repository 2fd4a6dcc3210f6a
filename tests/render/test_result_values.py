"""Results as b-CAP Tester shows them."""

from __future__ import annotations

import pytest
from hypothesis import given

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.render.value_text import reply_values_text, variant_values_text
from tests.strategies import variants

JOINTS = Variant.array(VT.R4, (12.422607421875, 60.3607177734375, 0.0))


@pytest.mark.parametrize(
    ("variant", "text", "full"),
    [
        (JOINTS, "12.42261, 60.36072, 0.00000", "12.422607, 60.360718, 0.0"),
        (Variant(VT.R8, 0.1), "0.10000", "0.1"),
        (Variant(VT.R8, 1e300), "1.00000e+300", "1e+300"),
        (Variant(VT.R8, float("nan")), "nan", "nan"),
        (Variant(VT.I4, 2), "2", "2"),
        (EMPTY, "(EMPTY)", "(EMPTY)"),
        (Variant(VT.BSTR, "a\x1b[31m\u202e"), "a\\x1b[31m\\u202e", "a\\x1b[31m\\u202e"),
        (Variant.array(VT.UI1, b"\x01\xab"), "01 AB", "01 AB"),
        (Variant.array(VT.VARIANT, (Variant(VT.I4, 1), JOINTS)), None, None),
        (Variant.array(VT.BSTR, ("a", "b")), "a, b", "a, b"),
        (Variant(VT.BOOL, True), "true", "true"),
    ],
)
def test_text(variant: Variant, text: str | None, full: str | None) -> None:
    nested = "(1; 12.42261, 60.36072, 0.00000)"
    assert variant_values_text(variant) == (nested if text is None else text)
    if full is not None:
        assert variant_values_text(variant, full=True) == full


def test_much_is_cut() -> None:
    assert variant_values_text(Variant.array(VT.I4, tuple(range(1000)))).endswith("511 … 488 more")
    assert len(variant_values_text(Variant(VT.BSTR, "x" * 10_000))) == 4001


def test_no_argument_is_empty() -> None:
    assert reply_values_text(Frame(encode_frame(1, 0, 0, ()))) == "(EMPTY)"
    assert reply_values_text(Frame(encode_frame(1, 0, 0, (Variant(VT.I4, 7),)))) == "7"


@given(variants())
def test_any_value_is_harmless(variant: Variant) -> None:
    assert all(char.isprintable() or char == "\u3000" for char in variant_values_text(variant))
    assert all(char.isprintable() or char == "\u3000" for char in variant_values_text(variant, full=True))
