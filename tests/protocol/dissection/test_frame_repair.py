"""Damage done on purpose is found again."""

from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.frame_content import FrameContent
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, encode_argument
from bcapscope.protocol.dissection.frame_repair import LONGEST_REPAIRED, ByteEdit, FrameRepair, find_repair
from tests.damaged import CHANGE_MODE, DONE, GET_MODE, HANDLE, MOVE, MOVED, NUMBER, SOUND, TEXT, without
from tests.strategies import mutated_frames

ZERO = encode_argument(Variant(VT.I4, 0))


def lost(*offsets: int) -> tuple[ByteEdit, ...]:
    return tuple(ByteEdit(offset, b"", b"\0") for offset in offsets)


@pytest.mark.parametrize("frame", SOUND)
def test_sound_frames_need_no_repair(frame: bytes) -> None:
    assert find_repair(frame) is None


@pytest.mark.parametrize(
    ("name", "raw", "is_request", "found"),
    [
        ("argument count of one byte", without(DONE, 14), False, FrameRepair(DONE, lost(14))),
        ("function id and handle", without(MOVE, 12, 28), True, FrameRepair(MOVE, lost(12, 27))),
        ("result and data", without(MOVED, 12, 56), False, FrameRepair(MOVED, lost(12, 55))),
        ("length field", without(MOVE, 4), True, FrameRepair(MOVE, lost(4))),
        (
            "five zeros for four",
            GET_MODE[:-1] + b"\0\x04",
            True,
            FrameRepair(GET_MODE, (ByteEdit(len(GET_MODE) - 1, b"\0", b""),)),
        ),
        (
            "two zeros too many",
            CHANGE_MODE[:12] + b"\0" + CHANGE_MODE[12:40] + b"\0" + CHANGE_MODE[40:],
            True,
            FrameRepair(CHANGE_MODE, (ByteEdit(13, b"\0", b""), ByteEdit(44, b"\0", b""))),
        ),
        (
            "wrong length",
            b"\x01\x04\0\0\0" + DONE[5:],
            False,
            FrameRepair(DONE, (ByteEdit(1, b"\x04\0\0\0", b"\x10\0\0\0"),)),
        ),
        ("wrong EOT", DONE[:-1] + b"\x05", False, FrameRepair(DONE, (ByteEdit(15, b"\x05", b"\x04"),))),
        ("bytes behind it", DONE + b"\r\n", False, FrameRepair(DONE, (ByteEdit(16, b"\r\n", b""),))),
        ("no SOH", MOVE[1:], True, FrameRepair(MOVE, (ByteEdit(0, b"", b"\x01"),))),
        ("cut in the command", MOVE[:53], True, FrameRepair(MOVE[:53], (), 47)),
        ("cut before EOT", MOVE[:-1], True, FrameRepair(MOVE[:-1], (), 1)),
        ("cut, and two lost", without(MOVE, 12, 28)[:51], True, FrameRepair(MOVE[:53], lost(12, 27), 47)),
        ("cut, and one lost", without(MOVE, 12)[:51], True, FrameRepair(MOVE[:52], lost(12), 48)),
    ],
)
def test_damage(name: str, raw: bytes, is_request: bool, found: FrameRepair) -> None:
    assert find_repair(raw, is_request) == found, name
    assert find_repair(raw) == found, name


def test_misread_command() -> None:
    raw = CHANGE_MODE.replace(b"n\0", b"\x8e\0").replace(b"e\0M", b"\x85\0M")
    edits = (ByteEdit(55, b"\x8e", b"n"), ByteEdit(59, b"\x85", b"e"))
    assert find_repair(raw, True) == FrameRepair(CHANGE_MODE, edits)
    assert find_repair(raw, False) is None


def test_a_misspelt_command_is_no_damage() -> None:
    assert find_repair(encode_frame(1, 0, 64, (HANDLE, Variant(VT.BSTR, "slvChnageMode"), EMPTY))) is None


@pytest.mark.parametrize(
    ("raw", "found"),
    [
        (NUMBER, FrameRepair(NUMBER, (), is_argument=True)),
        (
            NUMBER[1:] + NUMBER[:1],
            FrameRepair(NUMBER, (ByteEdit(0, b"", b"\x0a"), ByteEdit(13, b"\x0a", b"")), is_argument=True),
        ),
        (TEXT + b"\0", FrameRepair(TEXT, (ByteEdit(40, b"\0", b""),), is_argument=True)),
        (without(TEXT, 13), FrameRepair(TEXT, lost(13), is_argument=True)),
        (ZERO[:-1], FrameRepair(ZERO, lost(13), is_argument=True)),
    ],
)
def test_arguments_on_their_own(raw: bytes, found: FrameRepair) -> None:
    assert find_repair(raw) == found


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\x01",
        b"GET / HTTP/1.1",
        encode_frame(1, 0, 200, (HANDLE,)),  # sound, of a function that does not exist
        MOVE[:30] + b"\xff" + MOVE[31:],
        without(MOVE, 12, 28, 60),
        without(CHANGE_MODE, 12)[:40] + b"\0" + without(CHANGE_MODE, 12)[40:],  # one lost, one too many
        bytes(LONGEST_REPAIRED + 1),
    ],
)
def test_what_nothing_small_explains(raw: bytes) -> None:
    assert find_repair(raw) is None


def test_values_inside_others_are_weighed_too() -> None:
    pose = Variant.array(VT.VARIANT, (Variant(VT.I4, 7), Variant.array(VT.UI1, b"x"), EMPTY))
    frame = encode_frame(1, 0, 64, (HANDLE, Variant(VT.BSTR, "slvMove"), pose))
    assert find_repair(without(frame, 76, 82), True) == FrameRepair(frame, lost(76, 81))


def test_zeros_of_long_frames_are_not_repaired_but_a_cut_is_seen() -> None:
    frame = encode_frame(1, 0, 0, (Variant.array(VT.UI1, bytes(LONGEST_REPAIRED)),))
    assert find_repair(without(frame, 12)) is None
    assert find_repair(frame[:-5]) == FrameRepair(frame[:-5], (), 5)
    assert find_repair(frame[15:-1] + b"\0") is None


@given(st.sampled_from(SOUND), st.data())
def test_one_lost_zero_is_always_found(frame: bytes, data: st.DataObject) -> None:
    offset = data.draw(st.sampled_from([at for at in range(1, len(frame)) if frame[at] == 0]))
    found = find_repair(without(frame, offset))
    assert found is not None
    assert not FrameContent(found.raw).problems
    assert len(found.raw) == len(frame)


@given(st.binary(max_size=80) | mutated_frames(), st.sampled_from([True, False, None]))
def test_any_bytes_are_taken_and_edits_lead_to_the_repair(raw: bytes, is_request: bool | None) -> None:
    found = find_repair(raw, is_request)
    if found is None:
        return
    assert all(a.offset < b.offset for a, b in pairwise(found.edits))
    data, moved = raw, 0
    for offset, wrong, meant in found.edits:
        at = offset + moved
        assert data[at : at + len(wrong)] == wrong
        data = data[:at] + meant + data[at + len(wrong) :]
        moved += len(meant) - len(wrong)
    assert data == found.raw


def test_the_effort_is_bounded() -> None:
    """The longest frame that is repaired, of random bytes, is given up within the test's time-out."""
    noise = Random(4).randbytes(LONGEST_REPAIRED - 15)
    raw = b"\x01" + (LONGEST_REPAIRED + 2).to_bytes(4, "little") + bytes(4) + b"\x40\0\0\0\x03\0" + noise
    assert find_repair(raw) is None
