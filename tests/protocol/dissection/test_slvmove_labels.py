"""Names for the parts of what slvMove carries."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.dissection.value_labels import NO_LABEL, ValueLabel, slvmove_label
from tests.strategies import variants

JOINTS = [(f"J{axis}", "deg") for axis in range(1, 9)]
POSITION = [("X", "mm"), ("Y", "mm"), ("Z", "mm"), ("Rx", "deg"), ("Ry", "deg"), ("Rz", "deg"), ("Fig", "")]


def row(count: int, vt: int = VT.R8) -> Variant:
    return Variant.array(vt, tuple(float(number) for number in range(count)))


def listed(*values: Variant) -> Variant:
    return Variant.array(VT.VARIANT, values)


def named(part: ValueLabel) -> list[tuple[str, str]]:
    return [(each.name, each.unit) for each in part.elements]


@pytest.mark.parametrize("is_request", [True, False])
@pytest.mark.parametrize(("count", "names"), [(6, JOINTS[:6]), (7, POSITION), (8, JOINTS)])
def test_bare_pose(count: int, names: list[tuple[str, str]], is_request: bool) -> None:
    found = slvmove_label(row(count), is_request)
    assert named(found) == names
    assert found.name == ""
    assert str(found.text) == f"{'P' if count == 7 else 'J'} pose, guessed"


def test_pose_as_a_list_of_numbers() -> None:
    numbers = listed(*(Variant(VT.R8, float(number)) for number in range(8)))
    assert named(slvmove_label(numbers, is_request=True)) == JOINTS


def test_number_that_the_ros_driver_appends() -> None:
    values = (*map(float, range(8)), float(0x400000 | 0x3F))
    last = slvmove_label(Variant.array(VT.R8, values), is_request=True).elements[8]
    assert (last.name, last.unit) == ("axes", "")


def test_set_point_with_io() -> None:
    found = slvmove_label(listed(row(7), Variant(VT.I4, 0x10000)), is_request=True)
    assert [part.name for part in found.elements] == ["pose", "hand I/O"]
    assert named(found.elements[0]) == POSITION
    assert str(found.text) == "parts guessed"


def test_set_point_with_user_io() -> None:
    run = (Variant(VT.I4, 128), Variant(VT.I4, 8))
    found = slvmove_label(listed(row(8), *run, Variant.array(VT.UI1, b"\x01"), *run), is_request=True)
    assert [part.name for part in found.elements] == [
        "pose",
        "user I/O to write, offset",
        "user I/O to write, bits",
        "user I/O to write, data",
        "user I/O to read, offset",
        "user I/O to read, bits",
    ]


def test_mini_io_both_ways() -> None:
    word, user = Variant(VT.I4, 0x1000000), Variant.array(VT.UI1, b"\x01")
    found = slvmove_label(listed(row(8), word, word), is_request=True)
    assert [part.name for part in found.elements] == ["pose", "mini I/O", "hand I/O"]
    found = slvmove_label(listed(row(8), word, word), is_request=False)
    assert [part.name for part in found.elements] == ["pose", "mini I/O", "hand I/O"]
    found = slvmove_label(listed(row(8), user), is_request=False)
    assert [part.name for part in found.elements] == ["pose", "user I/O"]


def test_feedback_with_everything() -> None:
    word = Variant(VT.I4, 5)
    found = slvmove_label(listed(word, row(15), word, row(8)), is_request=False)
    assert [part.name for part in found.elements] == ["time stamp", "pose", "hand I/O", "motor current"]
    assert named(found.elements[1]) == [*POSITION, *JOINTS]
    assert named(found.elements[3]) == [(name, "") for name, _ in JOINTS]


@pytest.mark.parametrize(
    "variant",
    [
        Variant(VT.EMPTY, None),
        Variant(VT.BSTR, "P(1,2,3)"),
        row(3),
        row(0),
        listed(),
        listed(Variant(VT.BSTR, "x"), row(8)),
        Variant.array(VT.UI1, b"\x01\x02\x03\x04\x05\x06"),
        Variant(VT.ERROR, 5),
    ],
)
@pytest.mark.parametrize("is_request", [True, False])
def test_what_is_no_pose_has_no_names(variant: Variant, is_request: bool) -> None:
    assert slvmove_label(variant, is_request) == NO_LABEL


@given(variants(), st.booleans())
def test_any_value_can_be_asked_for_its_parts(variant: Variant, is_request: bool) -> None:
    found = slvmove_label(variant, is_request)
    if found.elements:
        assert isinstance(variant.value, tuple)
        assert len(found.elements) <= len(variant.value)


def test_a_pose_in_a_list_of_its_own_is_an_element() -> None:
    (pose,) = slvmove_label(listed(row(8)), is_request=True).elements
    assert (pose.name, named(pose)) == ("pose", JOINTS)
    assert slvmove_label(listed(row(8), Variant(VT.BSTR, "?")), is_request=True) is NO_LABEL
