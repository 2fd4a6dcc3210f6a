"""What fields mean, in words."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Value, Variant
from bcapscope.protocol.dissection.frame_field import frame_fields
from bcapscope.render.frame_tree import field_meaning
from bcapscope.render.value_text import value_text


@pytest.mark.parametrize(
    ("value", "vt", "text"),
    [
        (True, VT.BOOL, "true"),
        (False, VT.BOOL, "false"),
        (-5, VT.I4, "-5"),
        (2**64 - 1, VT.UI8, "18446744073709551615"),
        (0.1, VT.R8, "0.1"),
        (0.30000000000000004, VT.R8, "0.30000000000000004"),
        (0.10000000149011612, VT.R4, "0.1"),
        (16777216.0, VT.R4, "16777216.0"),
        (-103.21731567382812, VT.R4, "-103.217316"),
        (-0.0, VT.R4, "-0.0"),
        (float("nan"), VT.R4, "nan"),
        (float("-inf"), VT.R8, "-inf"),
        (125000, VT.CY, "125000, as currency 12.5"),
        (39965.5, VT.DATE, "39965.5, 2009-06-01 12:00:00"),
        (-1.5, VT.DATE, "-1.5"),
        (float("nan"), VT.DATE, "nan"),
        (-2147467259, VT.ERROR, "-2147467259 E_FAIL"),
        ('a"b\n', VT.BSTR, '"a\\"b\\n"'),
        (None, VT.EMPTY, ""),
        (b"\x01", VT.UI1, ""),
    ],
)
def test_values(value: Value, vt: int, text: str) -> None:
    assert value_text(value, vt) == text


def test_long_strings_are_cut_unless_all_is_asked_for() -> None:
    assert value_text("x" * 70, VT.BSTR) == '"' + "x" * 60 + '"… 10 more characters'
    assert value_text("x" * 70, VT.BSTR, None) == '"' + "x" * 70 + '"'


def test_fields_of_a_request() -> None:
    arguments = (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant.array(VT.UI1, b"\x01\x02"))
    found = frame_fields(Frame(encode_frame(5, 0, 64, arguments)), is_request=True)
    assert [field_meaning(each) for each in found] == [
        "",
        "70",
        "5",
        "0",
        "64 Robot_Execute",
        "3",
        "VT_I4 1, handle of a Robot",
        'VT_BSTR "slvMove"',
        "VT_UI1|VT_ARRAY 2 bytes",
        "",
    ]
    assert [field_meaning(each) for each in found[7].children] == ["24", "VT_BSTR", "1", ""]
    assert [field_meaning(each) for each in found[7].children[3].children] == ["14", '"slvMove"']


def test_axes_have_units() -> None:
    arguments = (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (1.5,) * 8))
    argument = frame_fields(Frame(encode_frame(5, 0, 64, arguments)), is_request=True)[8]
    assert field_meaning(argument) == "VT_R8|VT_ARRAY 8 elements, J pose, guessed"
    assert field_meaning(argument.children[-1].children[0]) == "1.5 deg"


def test_result_has_name_and_meaning() -> None:
    assert field_meaning(frame_fields(Frame(encode_frame(1, 0, 0)), is_request=False)[4]) == "S_OK, done"
    found = field_meaning(frame_fields(Frame(encode_frame(1, 0, 0x83500121)), is_request=False)[4])
    assert found.startswith("0x83500121, ")


def test_bytes_without_a_meaning_are_counted() -> None:
    found = frame_fields(Frame(encode_frame(1, 0, 2)[:-1] + b"\x01\x04"), is_request=True)
    assert [field_meaning(each) for each in found if each.name == "left over"] == ["1 byte"]
