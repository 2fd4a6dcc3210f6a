"""Command names that are nearly right."""

import pytest

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.dissection.similar_commands import MisreadByte, SimilarCommand, find_similar_command


def call(name: str, function_id: int = 64) -> bytes:
    return encode_frame(1, 0, function_id, (Variant(VT.I4, 1), Variant(VT.BSTR, name), EMPTY))


@pytest.mark.parametrize(
    "name", ["slvMove", "SLVMOVE", "slvmove", "TakeArm", "", "MyOwnThing", "\u65e5\u672c"]
)
def test_known_names_and_names_like_no_other_are_left_alone(name: str) -> None:
    assert find_similar_command(call(name)) is None


def test_a_name_is_looked_up_among_those_of_its_function() -> None:
    assert find_similar_command(call("slvMove", 17)) is None
    assert find_similar_command(call("slvM\x8fve", 17)) is None


def test_misread_characters() -> None:
    found = find_similar_command(call("slvCha\x8eg\x85Mode"))
    spots = (MisreadByte(55, 0x8E, 0x6E), MisreadByte(59, 0x85, 0x65))
    assert found == SimilarCommand("slvCha\x8eg\x85Mode", "slvChangeMode", spots)


def test_both_bytes_of_a_character_misread() -> None:
    found = find_similar_command(call("slvM\u6f6fve"))
    assert found is not None
    assert found.misread_bytes == (MisreadByte(52, 0x6F, 0x00),)


@pytest.mark.parametrize(
    ("name", "near"), [("slvChnageMode", "slvChangeMode"), ("slvMov", "slvMove"), ("TakeArms", "TakeArm")]
)
def test_misspelt_names_are_not_put_right(name: str, near: str) -> None:
    assert find_similar_command(call(name)) == SimilarCommand(name, near, ())


def test_a_character_of_two_units_is_none_that_was_misread() -> None:
    """It would move all that follow it; the name is only near."""
    assert find_similar_command(call("slvM\U0001f600ve")) == SimilarCommand("slvM\U0001f600ve", "slvMove", ())


def test_a_name_that_is_mostly_misread_is_nothing() -> None:
    assert find_similar_command(call("\x8e\x8e\x8eMove")) is None


def test_a_megabyte_of_name_is_compared_only_at_its_beginning() -> None:
    assert find_similar_command(call("slvMov" * 200_000)) is None


@pytest.mark.parametrize(
    "frame",
    [
        encode_frame(1, 0, 64),
        encode_frame(1, 0, 64, (EMPTY, EMPTY)),
        encode_frame(1, 0, 0),
        encode_frame(1, 0, 4, (Variant(VT.I4, 1),)),
    ],
)
def test_frames_without_a_command(frame: bytes) -> None:
    assert find_similar_command(frame) is None
