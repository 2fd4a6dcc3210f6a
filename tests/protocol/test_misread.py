"""Command names that are nearly right."""

import pytest

from bcapscope.protocol.frame import encode
from bcapscope.protocol.misread import NearName, Spot, near_name
from bcapscope.protocol.variant import EMPTY, VT, Variant


def call(name: str, function_id: int = 64) -> bytes:
    return encode(1, 0, function_id, (Variant(VT.I4, 1), Variant(VT.BSTR, name), EMPTY))


@pytest.mark.parametrize(
    "name", ["slvMove", "SLVMOVE", "slvmove", "TakeArm", "", "MyOwnThing", "\u65e5\u672c"]
)
def test_known_names_and_names_like_no_other_are_left_alone(name: str) -> None:
    assert near_name(call(name)) is None


def test_a_name_is_looked_up_among_those_of_its_function() -> None:
    assert near_name(call("slvMove", 17)) is None
    assert near_name(call("slvM\x8fve", 17)) is None


def test_misread_characters() -> None:
    found = near_name(call("slvCha\x8eg\x85Mode"))
    spots = (Spot(55, 0x8E, 0x6E), Spot(59, 0x85, 0x65))
    assert found == NearName("slvCha\x8eg\x85Mode", "slvChangeMode", spots)


def test_both_bytes_of_a_character_misread() -> None:
    found = near_name(call("slvM\u6f6fve"))
    assert found is not None
    assert found.spots == (Spot(52, 0x6F, 0x00),)


@pytest.mark.parametrize(
    ("name", "near"), [("slvChnageMode", "slvChangeMode"), ("slvMov", "slvMove"), ("TakeArms", "TakeArm")]
)
def test_misspelt_names_are_not_put_right(name: str, near: str) -> None:
    assert near_name(call(name)) == NearName(name, near, ())


def test_a_character_of_two_units_is_none_that_was_misread() -> None:
    """It would move all that follow it; the name is only near."""
    assert near_name(call("slvM\U0001f600ve")) == NearName("slvM\U0001f600ve", "slvMove", ())


def test_a_name_that_is_mostly_misread_is_nothing() -> None:
    assert near_name(call("\x8e\x8e\x8eMove")) is None


def test_a_megabyte_of_name_is_compared_only_at_its_beginning() -> None:
    assert near_name(call("slvMov" * 200_000)) is None


@pytest.mark.parametrize(
    "frame",
    [
        encode(1, 0, 64),
        encode(1, 0, 64, (EMPTY, EMPTY)),
        encode(1, 0, 0),
        encode(1, 0, 4, (Variant(VT.I4, 1),)),
    ],
)
def test_frames_without_a_command(frame: bytes) -> None:
    assert near_name(frame) is None
