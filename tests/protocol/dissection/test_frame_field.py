"""Where the fields of frames stand."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterable, Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Framing, Problem, encode_frame
from bcapscope.protocol.codec.frame_content import HEADER_SIZE
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.protocol.dissection.frame_field import UNREAD, FrameField, envelope_fields, frame_fields
from tests.frames import FRAME_IDS, FRAMES, FramePair
from tests.samples.problems import problem_of
from tests.strategies import frames, mutated_frames

SLV_MOVE = (
    Variant(VT.I4, 1),
    Variant(VT.BSTR, "slvMove"),
    Variant.array(VT.R8, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.0, 0.0)),
)


def leaves(found: Iterable[FrameField]) -> Iterator[FrameField]:
    for each in found:
        if each.children:
            yield from leaves(each.children)
        else:
            yield each


def walk(found: Iterable[FrameField]) -> Iterator[FrameField]:
    for each in found:
        yield each
        yield from walk(each.children)


def names(found: Iterable[FrameField]) -> list[tuple[str, int, int]]:
    return [(each.name, each.start, each.stop) for each in found]


def problems(found: Iterable[FrameField]) -> list[Problem]:
    return sorted(problem for each in leaves(found) for problem in each.problems)


def request(*arguments: Variant, code: int = 64) -> Frame:
    return Frame(encode_frame(5, 0, code, arguments))


def hold_together(frame: Frame, is_request: bool) -> None:
    """Check what is true of the fields of any frame."""
    found = frame_fields(frame, is_request, 64, "slvMove")
    parts = list(leaves(found))
    assert b"".join(frame.body[each.start : each.stop] for each in parts) == frame.body
    assert all(before.stop == after.start for before, after in pairwise(parts))
    assert all(each.stop > each.start or each.name in ("EOT", UNREAD) for each in parts)
    for each in walk(found):
        if each.children:
            assert (each.children[0].start, each.children[-1].stop) == (each.start, each.stop)
            assert {problem for child in each.children for problem in child.problems} == set(each.problems)
    outside = [
        problem for problem in problems(envelope_fields(frame)) if problem.code not in ("soh", "length")
    ]
    assert sorted(problems(found) + outside) == sorted(frame.problems)
    wire = list(leaves(envelope_fields(frame)))
    assert not wire or b"".join(frame.raw[each.start : each.stop] for each in wire) == frame.raw


def test_header_fields_of_a_request() -> None:
    found = frame_fields(Frame(encode_frame(5, 7, 2)), is_request=True)
    assert names(found) == [
        ("SOH", 0, 1),
        ("length", 1, 5),
        ("serial", 5, 7),
        ("reserved", 7, 9),
        ("function id", 9, 13),
        ("argument count", 13, 15),
        ("EOT", 15, 16),
    ]
    assert [each.value for each in found] == [None, 16, 5, 7, 2, 0, None]
    assert str(found[4].text) == "Service_Stop"


def test_reply_has_hresult_in_place_of_function() -> None:
    found = frame_fields(Frame(encode_frame(5, 0, 0x83500121)), is_request=False)
    assert (found[4].name, found[4].value, str(found[4].text)) == ("HRESULT", 0x83500121, "0x83500121")
    assert frame_fields(Frame(encode_frame(5, 0, 0x900)), is_request=False)[4].text == "S_EXECUTING"


def test_arguments_have_the_names_of_the_function() -> None:
    found = frame_fields(request(*SLV_MOVE), is_request=True)[6:-1]
    assert [each.name for each in found] == ["hRobot", "bstrCommand", "vntParam"]
    assert [each.value for each in found] == [each.value for each in SLV_MOVE]
    assert names(found[0].children) == [
        ("length", 15, 19),
        ("type", 19, 21),
        ("element count", 21, 25),
        ("data", 25, 29),
    ]
    assert [each.value for each in found[0].children] == [10, VT.I4, 1, 1]
    assert str(found[0].children[1].text) == "VT_I4"


def test_result_has_the_name_that_the_function_gives_it() -> None:
    reply = Frame(encode_frame(5, 0, 0, (Variant(VT.I4, 9),)))
    assert frame_fields(reply, False, 7)[6].name == "hRobot"
    assert frame_fields(reply, False)[6].name == "pVal"


def test_strings_have_their_own_length() -> None:
    data = frame_fields(request(*SLV_MOVE), is_request=True)[7].children[-1]
    assert (data.name, data.value, data.start, data.stop) == ("data", "slvMove", 39, 57)
    assert [(each.name, each.start, each.stop, each.value) for each in data.children] == [
        ("bytes", 39, 43, 14),
        ("characters", 43, 57, "slvMove"),
    ]


@pytest.mark.parametrize("command", ["slvMove", "SLVMOVE"])
def test_set_point_elements_are_axes(command: str) -> None:
    frame = request(SLV_MOVE[0], Variant(VT.BSTR, command), SLV_MOVE[2])
    argument = frame_fields(frame, is_request=True)[8]
    assert str(argument.text) == "J pose, guessed"
    axes = argument.children[-1].children
    assert [(each.name, each.unit) for each in axes] == [(f"J{axis}", "deg") for axis in range(1, 9)]
    assert [each.value for each in axes] == list(SLV_MOVE[2].value)  # type: ignore[arg-type]
    assert (axes[0].start, axes[-1].stop) == (67, 131)


def test_reply_to_slv_move_names_its_parts() -> None:
    pose = Variant.array(VT.R8, (100.0, 200.0, 300.0, 0.0, 90.0, 0.0, 5.0))
    reply = Frame(encode_frame(5, 0, 0, (Variant.array(VT.VARIANT, (Variant(VT.I4, 77), pose)),)))
    argument = frame_fields(reply, False, 64, "slvMove")[6]
    stamp, row = argument.children[-1].children
    assert (stamp.name, stamp.value) == ("time stamp", 77)
    assert row.name == "pose"
    axes = row.children[-1].children
    assert [(each.name, each.unit) for each in axes][2:5] == [("Z", "mm"), ("Rx", "deg"), ("Ry", "deg")]


def test_other_commands_have_plain_elements() -> None:
    frame = request(SLV_MOVE[0], Variant(VT.BSTR, "CurJnt"), SLV_MOVE[2])
    assert frame_fields(frame, is_request=True)[8].children[-1].children[0].name == "[0]"


def test_nested_elements_have_no_length_before_them() -> None:
    inner = Variant.array(VT.BSTR, ("A", ""))
    frame = request(Variant.array(VT.VARIANT, (inner, Variant(VT.BOOL, True))), code=200)
    data = frame_fields(frame, is_request=True)[6].children[-1]
    first, second = data.children
    assert names(first.children) == [("type", 25, 27), ("element count", 27, 31), ("data", 31, 41)]
    assert names(first.children[-1].children) == [("[0]", 31, 37), ("[1]", 37, 41)]
    assert names(first.children[-1].children[1].children) == [("bytes", 37, 41)]
    assert (second.name, second.value, second.start, second.stop) == ("[1]", True, 41, 49)


def test_serial_line_and_version_1_frames_end_differently() -> None:
    line = frame_fields(Frame(encode_frame(1, 0, 2, (), Framing.SERIAL_LINE)), is_request=True)
    assert names(line[-2:]) == [("CRC", 15, 17), ("EOT", 17, 18)]
    version_1 = frame_fields(Frame(encode_frame(1, 1, 2, (), Framing.VERSION_1)), is_request=True)
    assert names(version_1[-2:]) == [("mode byte", 15, 16), ("EOT", 16, 17)]


def test_compressed_frame_has_two_sets_of_fields() -> None:
    frame = Frame(encode_frame(1, 1, 64, SLV_MOVE, Framing.VERSION_1_ZLIB))
    found = frame_fields(frame, is_request=True)
    assert found[8].name == "vntParam"
    size = len(frame.raw)
    assert names(envelope_fields(frame)) == [
        ("SOH", 0, 1),
        ("length", 1, 5),
        ("serial", 5, 7),
        ("reserved", 7, 9),
        ("unpacked size", 9, 13),
        ("compressed", 13, size - 2),
        ("mode byte", size - 2, size - 1),
        ("EOT", size - 1, size),
    ]
    assert envelope_fields(frame)[4].value == len(frame.body) - 10
    assert envelope_fields(frame)[5].value == frame.raw[13:-2]
    assert envelope_fields(request()) == ()


def test_problems_of_the_compression_are_in_the_envelope() -> None:
    raw = bytearray(encode_frame(1, 1, 64, SLV_MOVE, Framing.VERSION_1_ZLIB))
    raw[9] += 1
    frame = Frame(bytes(raw))
    assert [each.problems for each in envelope_fields(frame) if each.problems] == [frame.problems]
    assert problems(frame_fields(frame, is_request=True)) == []


def test_a_wrong_length_of_a_compressed_frame_is_in_the_envelope_too() -> None:
    raw = bytearray(encode_frame(1, 1, 64, SLV_MOVE, Framing.VERSION_1_ZLIB))
    raw[1] += 1
    frame = Frame(bytes(raw))
    assert [each.name for each in envelope_fields(frame) if each.problems] == ["length"]


@pytest.mark.parametrize(
    ("raw", "name"),
    [
        (encode_frame(5, 0, 64, SLV_MOVE)[:-1] + b"\x05", "EOT"),
        (encode_frame(5, 0, 64)[:-1], "EOT"),
        (encode_frame(5, 0, 64) + b"\x04", "left over"),
        (encode_frame(5, 0, 64)[:13] + b"\x02\x00\x04", "argument count"),
        (b"\x01\x10" + encode_frame(5, 0, 64, SLV_MOVE)[2:], "length"),
    ],
)
def test_problems_stand_at_the_field_they_belong_to(raw: bytes, name: str) -> None:
    found = frame_fields(Frame(raw), is_request=True)
    assert name in {each.name for each in leaves(found) if each.problems}


def test_damaged_eot_is_a_field_of_one_byte() -> None:
    last = frame_fields(Frame(encode_frame(5, 0, 64)[:-1] + b"\x05"), is_request=True)[-1]
    assert (last.name, last.start, last.stop) == ("EOT", 15, 16)
    assert [problem.code for problem in last.problems] == ["eot"]


@pytest.mark.parametrize(
    ("length", "last"), [((16).to_bytes(4, "little"), 15), (b"\x10\x01\0\0", 16), (b"\x10\0\0\x01", 16)]
)
def test_a_last_byte_is_the_eot_if_the_whole_length_says_so(length: bytes, last: int) -> None:
    field = frame_fields(Frame(b"\x01" + length + bytes(11)), is_request=True)[-1]
    assert (field.name, field.start, field.stop) == ("EOT", last, 16)


def test_a_header_alone_has_no_eot() -> None:
    field = frame_fields(Frame(b"\x01" + (15).to_bytes(4, "little") + bytes(9) + b"\x04"), is_request=True)[
        -1
    ]
    assert (field.name, field.start, field.stop) == ("EOT", 15, 15)


def test_bytes_behind_the_arguments_are_left_over() -> None:
    field = frame_fields(Frame(encode_frame(5, 0, 64)[:-1] + b"\x09\x08\x04"), is_request=True)[-2]
    assert (field.name, field.value) == ("left over", b"\x09\x08")


def array_of_many_with_two() -> bytes:
    argument = struct.pack("<IHIdd", 22, ARRAY | VT.R8, 1000, 1.0, 2.0)
    return struct.pack("<BIHHIH", 1, 16 + 2 * len(argument), 5, 0, 200, 2) + 2 * argument + b"\x04"


def test_value_that_breaks_off_where_its_argument_ends() -> None:
    found = frame_fields(Frame(array_of_many_with_two()), is_request=True)
    for argument in found[6:8]:
        assert [problem.code for problem in argument.problems] == ["data"]
        last = argument.children[-1]
        assert (last.name, last.start, last.stop) == (UNREAD, argument.stop, argument.stop)
        assert last.value is None
        assert last.problems == argument.problems
    assert found[8].name == "EOT"
    assert not found[8].problems


def test_bytes_behind_a_broken_value_are_unread() -> None:
    body = struct.pack("<IHI", 20, ARRAY | VT.R8, 2) + bytes(14)
    raw = struct.pack("<BIHHIH", 1, 16 + len(body), 5, 0, 200, 1) + body + b"\x04"
    argument = frame_fields(Frame(raw), is_request=True)[6]
    assert names(argument.children[-2:]) == [("data", 25, 33), (UNREAD, 33, 39)]
    assert argument.children[-1].value == bytes(6)


@pytest.mark.parametrize(("offset", "name"), [(10, "function id"), (16, "EOT"), (99, "EOT")])
def test_note_about_the_capture_stands_where_it_points_or_where_the_bytes_end(offset: int, name: str) -> None:
    note = problem_of(offset, "snapped", "the capture kept only its beginning")
    found = frame_fields(Frame(encode_frame(5, 0, 64), note), is_request=True)
    assert [(each.name, each.problems) for each in found if each.problems] == [(name, (note,))]


def test_elements_are_made_when_looked_at() -> None:
    frame = request(Variant.array(VT.UI2, tuple(range(60_000))), code=200)
    assert frame.arguments
    began = time.perf_counter()
    elements = frame_fields(frame, is_request=True)[6].children[-1].children
    assert elements[-1].value == 59_999
    assert len(elements) == 60_000
    assert [each.value for each in elements[1:3]] == [1, 2]
    assert time.perf_counter() - began < 0.01


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_frames_of_the_table_are_covered(pair: FramePair) -> None:
    for is_request in (True, False):
        hold_together(Frame(pair.data), is_request)


@given(frames(), st.booleans())
def test_sound_frames_are_covered(raw: bytes, is_request: bool) -> None:
    hold_together(Frame(raw), is_request)


@given(mutated_frames(), st.booleans())
def test_damaged_frames_are_covered(raw: bytes, is_request: bool) -> None:
    hold_together(Frame(raw + bytes(max(0, HEADER_SIZE - len(raw)))), is_request)


@given(st.binary(min_size=HEADER_SIZE, max_size=200), st.booleans())
def test_any_bytes_are_covered(raw: bytes, is_request: bool) -> None:
    hold_together(Frame(raw), is_request)


WORDS = st.sampled_from(
    [b"\x00", b"\x01\x00\x00\x00", b"\xff\xff\xff\xff", b"\x05\x20", b"\x0c\x20", b"\x08\x00"]
)


@given(st.lists(WORDS, min_size=8, max_size=60).map(b"".join), st.integers(0, 3), st.booleans())
def test_bytes_that_look_like_arguments_are_covered(body: bytes, argc: int, is_request: bool) -> None:
    header = struct.pack("<BIHHIH", 1, 16 + len(body), 1, 0, 64, argc)
    hold_together(Frame(header + body + b"\x04"), is_request)


def test_value_that_breaks_off_where_the_frame_ends() -> None:
    frame = Frame(request(Variant(VT.I4, 0)).raw[:25])
    hold_together(frame, is_request=True)
    assert [each.name for each in leaves(frame_fields(frame, is_request=True)) if each.problems] == [
        "length",
        UNREAD,
        "EOT",
    ]
