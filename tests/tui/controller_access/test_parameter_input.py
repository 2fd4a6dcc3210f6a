"""Parameters as they are typed."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant
from bcapscope.protocol.tables.command_catalogue import find_command
from bcapscope.tui.tester.typed_value import (
    PARAMETER_TYPES,
    check_text,
    command_hint,
    expected_input,
    type_label,
    type_numbers,
)


@pytest.mark.parametrize(
    ("vt", "text", "value"),
    [
        (VT.I4, " 2 ", Variant(VT.I4, 2)),
        (VT.I4, "0x101", Variant(VT.I4, 0x101)),
        (VT.EMPTY, "", EMPTY),
        (VT.BSTR, " a ", Variant(VT.BSTR, " a ")),
        (ARRAY | VT.R4, "1, 2.5", Variant.array(VT.R4, (1.0, 2.5))),
        (ARRAY | VT.VARIANT, "r8[]:1;bstr:J", None),
    ],
)
def test_what_is_typed_is_read(vt: int, text: str, value: Variant | None) -> None:
    found = check_text(vt, text)
    assert isinstance(found, Variant)
    assert value is None or found == value


@pytest.mark.parametrize(
    ("vt", "text", "what"),
    [
        (VT.I2, "70000", "-32768 to 32767"),
        (VT.I4, "two", "a whole number"),
        (VT.BOOL, "yes", "true or false"),
        (ARRAY | VT.R4, "1, x", "separate several by commas"),
        (VT.EMPTY, "1", "leave this empty"),
        (ARRAY | VT.VARIANT, "i4:x", "separated by semicolons"),
    ],
)
def test_what_does_not_fit_is_told_with_what_is_expected(vt: int, text: str, what: str) -> None:
    found = check_text(vt, text)
    assert isinstance(found, str)
    assert what in found


def test_every_type_has_a_label_and_an_explanation() -> None:
    assert type_label(ARRAY | VT.R4) == "ARRAY | R4"
    assert type_label(VT.I4) == "I4"
    assert len({type_label(vt) for vt in PARAMETER_TYPES}) == len(PARAMETER_TYPES) == 16 + 15
    assert all(expected_input(vt) for vt in PARAMETER_TYPES)


def test_the_catalogue_suggests_a_type() -> None:
    found = find_command(64, "SLVMOVE")
    assert found is not None
    assert type_numbers(found.parameter_types)[:2] == (ARRAY | VT.R4, ARRAY | VT.R8)
    assert "pose" in command_hint(found)
    assert find_command(64, "NoSuchCommand") is None
