"""How far bytes look like a sound frame."""

import pytest
from hypothesis import given

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant, encode_argument
from bcapscope.protocol.dissection.plausibility import (
    LARGEST_LIKELY,
    plausible_argument_end,
    plausible_length_field,
    plausible_prefix_length,
)
from tests.frames import ARGUMENT_IDS, ARGUMENTS, ArgumentPair
from tests.strategies import mutated_frames, variants

HANDLE = Variant(VT.I4, 1)
MOVE = encode_frame(
    1,
    0,
    64,
    (HANDLE, Variant(VT.BSTR, "slvMove"), Variant.array(VT.VARIANT, (HANDLE, Variant(VT.BSTR, "J")))),
)
DONE = encode_frame(1, 0, 0, (HANDLE,))


@pytest.mark.parametrize(("frame", "is_request"), [(MOVE, True), (MOVE, None), (DONE, False), (DONE, None)])
def test_sound_frames_are_reached_to_the_end(frame: bytes, is_request: bool | None) -> None:
    assert plausible_prefix_length(frame, len(frame), is_request) == len(frame)


@pytest.mark.parametrize("size", range(len(MOVE)))
def test_a_frame_that_breaks_off_is_sound_up_to_there(size: int) -> None:
    assert plausible_prefix_length(MOVE[:size], len(MOVE), True) == size


@pytest.mark.parametrize(
    ("offset", "byte", "trouble"),
    [
        (0, 2, 0),
        (10, 1, 9),  # function 320
        (13, 2, 13),  # two arguments where three belong
        (13, 4, 13),
        (15, 11, 15),  # an argument longer than its value
        (19, 8, 19),  # a string where the handle belongs
        (21, 2, 21),  # a scalar of two
        (33, 3, 33),  # a number where the command belongs
        (39, 7, 39),  # a string of an odd length
        (39, 200, 39),
        (61, 3, 57),  # VT_I4|VT_ARRAY, which does not fill its argument
        (63, 200, 63),  # an array of 200
        (67, 9, 67),  # type 9
        (len(MOVE) - 1, 5, len(MOVE) - 1),
    ],
)
def test_the_first_impossible_field_is_told(offset: int, byte: int, trouble: int) -> None:
    data = MOVE[:offset] + bytes((byte,)) + MOVE[offset + 1 :]
    assert plausible_prefix_length(data, len(data), True) == trouble


def test_who_sent_it_decides_what_may_stand_there() -> None:
    assert plausible_prefix_length(MOVE, len(MOVE), False) == 9  # 64 is no result
    assert plausible_prefix_length(DONE, len(DONE), True) == 9


@pytest.mark.parametrize("code", [0, 1, 0x900, 0x0F200501, 0x83500121, 0x80004005])
def test_results_that_exist(code: int) -> None:
    frame = encode_frame(1, 0, code)
    assert plausible_prefix_length(frame, len(frame), False) == len(frame)


def test_a_result_that_does_not_exist() -> None:
    frame = encode_frame(1, 0, 0x01000000)
    assert plausible_prefix_length(frame, len(frame), False) == 9


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_arguments(pair: ArgumentPair) -> None:
    assert plausible_argument_end(pair.data) == len(pair.data)
    assert plausible_argument_end(b"\xff" + pair.data + b"\xff", 1) == len(pair.data) + 1
    assert plausible_argument_end(pair.data[:-1]) is None


@given(variants())
def test_every_value_that_is_encoded_is_an_argument(variant: Variant) -> None:
    data = encode_argument(variant)
    assert plausible_argument_end(data) == len(data)


@given(mutated_frames())
def test_any_bytes_have_a_reach(data: bytes) -> None:
    assert 0 <= plausible_prefix_length(data, len(data), None) <= len(data)


def test_a_count_does_not_make_it_work() -> None:
    hollow = b"\x06\0\0\0" + b"\x0c\x20" + b"\xff\xff\xff\xff"
    assert plausible_argument_end(hollow) is None


@pytest.mark.parametrize(("length", "told"), [(15, None), (16, 16), (LARGEST_LIKELY + 1, None)])
def test_a_length_that_may_be_true(length: int, told: int | None) -> None:
    assert plausible_length_field(b"\x01" + length.to_bytes(4, "little")) == told


def test_no_length_at_all() -> None:
    assert plausible_length_field(b"\x01\x10\x00\x00") is None
