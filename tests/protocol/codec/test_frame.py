"""Frames: header first, the rest on demand; datagrams; and what `encode_frame` makes."""

from __future__ import annotations

import zlib
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.errors import LocalProtocolError, TooLargeError
from bcapscope.messages import Message
from bcapscope.protocol.codec import frame as frames_module
from bcapscope.protocol.codec import frame_content as contents
from bcapscope.protocol.codec.frame import (
    Frame,
    Framing,
    Malformed,
    Problem,
    encode_frame,
    parse_captured_datagram,
    parse_datagram,
    parse_single_frame,
)
from bcapscope.protocol.codec.frame_content import FrameContent
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, Variant, encode_argument
from tests.frames import (
    DAMAGED,
    DAMAGED_IDS,
    FRAME_IDS,
    FRAMES,
    Damaged,
    FramePair,
    bare,
    plain_frame,
    values_of,
)
from tests.fuzz import targets
from tests.fuzz.targets import check_frame
from tests.samples.problems import problem_of
from tests.strategies import Plan, frames, garbage, mutated_frames, plans

PLAIN = [pair for pair in FRAMES if pair.framing is Framing.PLAIN]
GOOD = FRAMES[2].data


def only(items: tuple[Frame | Malformed, ...]) -> Frame:
    (item,) = items
    assert isinstance(item, Frame)
    return item


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_packs_as_the_table_says(pair: FramePair) -> None:
    made = encode_frame(pair.serial, pair.reserved, pair.code, pair.arguments, pair.framing)
    assert made.hex() == pair.data.hex()


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
@pytest.mark.parametrize("time", ["first", "second"])
def test_reads_what_the_table_says_also_by_its_layout(pair: FramePair, time: str) -> None:
    frame = only(parse_datagram(pair.data))
    assert (frame.serial, frame.reserved, frame.code) == (pair.serial, pair.reserved, pair.code)
    assert (frame.length, frame.argc) == (len(pair.data), len(pair.arguments))
    found = tuple(argument.variant for argument in frame.arguments)
    assert repr(found) == repr(tuple(map(bare, pair.arguments)))
    assert (frame.problems, frame.framing, frame.raw) == ((), pair.framing, pair.data)
    assert (frame.template_match is not None) is (pair.framing is Framing.PLAIN)
    check_frame(frame)


def test_a_negative_hresult_is_sent_as_it_is_read_unsigned() -> None:
    assert encode_frame(1, 0, -2147467259) == encode_frame(1, 0, 0x80004005)
    assert encode_frame(1, 0, -1) == encode_frame(1, 0, 0xFFFFFFFF)


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_a_datagram_cut_anywhere_is_told_from_a_sound_one(pair: FramePair) -> None:
    for end in range(len(pair.data)):
        (item,) = parse_datagram(pair.data[:end])
        assert item.problems
        assert isinstance(item, Frame) is (end >= 15)
        targets.frame(pair.data[:end])


@pytest.mark.parametrize("sample", DAMAGED, ids=DAMAGED_IDS)
@pytest.mark.parametrize("time", ["first", "second"])
def test_damaged_frames_are_read_as_far_as_they_go(sample: Damaged, time: str) -> None:
    frame = parse_single_frame(sample.data)
    assert isinstance(frame, Frame)
    assert tuple((problem.offset, problem.code) for problem in frame.problems) == sample.problems
    assert repr(values_of(tuple(a.variant for a in frame.arguments))) == repr(sample.values)
    assert frame.template_match is None


def test_frames_glued_in_a_datagram_come_out_one_by_one() -> None:
    everything = b"".join(pair.data for pair in FRAMES)
    items = parse_datagram(everything)
    assert [item.raw for item in items] == [pair.data for pair in FRAMES]
    assert all(item.problems == () for item in items)


def test_all_bytes_of_a_length_count() -> None:
    huge = GOOD[:4] + b"\x01" + GOOD[5:]
    (item,) = parse_datagram(huge + GOOD)
    assert isinstance(item, Frame)
    assert (item.raw, item.length) == (huge + GOOD, 0x01000000 + len(GOOD))


def test_the_number_of_arguments_has_two_bytes() -> None:
    assert Frame(GOOD[:13] + b"\x02\x01" + GOOD[15:]).argc == 0x0102


def test_a_frame_equals_what_says_that_it_equals_it() -> None:
    assert Frame(GOOD) == mock.ANY
    assert Frame(GOOD) != GOOD


def test_a_frame_of_two_rows_of_numbers_has_both() -> None:
    rows = (Variant.array(VT.R4, (1.0, 2.0)), Variant.array(VT.I4, (3,)))
    frame = Frame(encode_frame(1, 0, 64, rows))
    assert (frame.variants, frame.problems) == (rows, ())


def test_many_small_frames_are_cut_without_copying_the_rest_each_time() -> None:
    small = encode_frame(1, 0, 2)
    assert len(parse_datagram(small * 100_000)) == 100_000


@pytest.mark.parametrize("first", PLAIN, ids=[pair.name for pair in PLAIN])
def test_a_datagram_cut_in_its_second_frame(first: FramePair) -> None:
    second = FRAMES[2].data
    for end in range(1, len(second)):
        sound, rest = parse_datagram(first.data + second[:end])
        assert (sound.raw, sound.problems) == (first.data, ())
        assert rest.raw == second[:end]
        assert rest.problems


@pytest.mark.parametrize(
    ("raw", "problems"),
    [
        ("", [(0, "soh")]),
        ("02", [(0, "soh")]),
        ("01", [(0, "short")]),
        ("0110000000010000000200000000", [(0, "short")]),
        ("FF10000000010000000200000000000004", [(0, "soh")]),
    ],
)
def test_bytes_that_are_no_frame(raw: str, problems: list[tuple[int, str]]) -> None:
    (item,) = parse_datagram(bytes.fromhex(raw))
    assert isinstance(item, Malformed)
    assert item.raw == bytes.fromhex(raw)
    assert item.missing == 0
    assert [(problem.offset, problem.code) for problem in item.problems] == problems


def test_bytes_behind_a_sound_frame_are_an_item_of_their_own() -> None:
    frame, rest = parse_datagram(FRAMES[0].data + b"\xee\xee")
    assert frame == Frame(FRAMES[0].data)
    assert rest == Malformed(b"\xee\xee", (Problem(0, "soh", Message("problem.soh", byte="EE")),))


@pytest.mark.parametrize("frame", PLAIN[:2])
def test_a_captured_datagram_with_one_frame_has_no_problem(frame: FramePair) -> None:
    assert parse_captured_datagram(frame.data) == (Frame(frame.data),)


def test_each_item_of_a_captured_datagram_is_there_once_and_only_the_first_has_the_problem() -> None:
    for first, second in ((PLAIN[0].data, PLAIN[1].data), (PLAIN[1].data, PLAIN[0].data)):
        items = parse_captured_datagram(first + second + b"\xee")
        assert [item.raw for item in items] == [first, second, b"\xee"]
        assert [[problem.code for problem in item.problems] for item in items] == [["length"], [], ["soh"]]
        assert [len(item.problems) for item in parse_captured_datagram(first + second)] == [1, 0]
        (problem,) = items[0].problems
        sizes = len(first), len(first + second) + 1
        assert problem.offset == len(first)
        assert str(problem.reason) == "length is %d, but the datagram has %d bytes" % sizes


def test_a_datagram_that_begins_otherwise_is_no_frame_whatever_follows() -> None:
    raw = b"\x02" + FRAMES[0].data[1:] + FRAMES[0].data
    (item,) = parse_datagram(raw)
    assert isinstance(item, Malformed)
    assert item.raw == raw


def test_a_frame_whose_length_ends_on_no_eot_takes_the_whole_datagram() -> None:
    raw = FRAMES[0].data[:-1] + b"\x05" + FRAMES[0].data
    frame = only(parse_datagram(raw))
    assert [problem.code for problem in frame.problems] == ["length", "left-over"]


def test_items_are_equal_by_what_they_hold() -> None:
    one, other = FRAMES[0].data, FRAMES[1].data
    note = problem_of(16, "cut", "the capture kept 16 of 20 bytes")
    assert Frame(one) == Frame(one) != Frame(other)
    assert Frame(one) != Frame(one, note)
    assert len({Frame(one), Frame(one), Frame(other)}) == 2
    assert Frame(one) != one
    assert Malformed(b"x", ()) == Malformed(b"x", ()) != Malformed(b"", (), 1)
    assert len({Malformed(b"x", ()), Malformed(b"x", ()), Malformed(b"y", ())}) == 2
    assert repr(Frame(one)) == "Frame('01100000000100000002000000000004')"
    assert repr(Malformed(b"x", ())) == "Malformed(raw=b'x', problems=(), missing=0)"


def test_a_note_is_a_problem_of_the_frame_and_not_of_its_bytes() -> None:
    note = problem_of(20, "cut", "the capture kept 20 of 82 bytes")
    cut = Frame(FRAMES[2].data[:20], note)
    assert cut.problems == (*FrameContent(cut.raw).problems, note)
    sound = Frame(FRAMES[2].data, note)
    assert sound.problems == (note,)
    assert sound.template_match is None
    assert Frame(FRAMES[2].data).problems == ()


def test_a_compressed_frame_has_its_code_at_once_and_spans_in_what_it_unpacks_to() -> None:
    (pair,) = (pair for pair in FRAMES if pair.framing is Framing.VERSION_1_ZLIB)
    frame = Frame(pair.data)
    assert frame.code == 64
    assert frame.argc == 3
    assert len(frame.body) > len(frame.raw)
    handle = frame.arguments[0]
    assert frame.body[handle.start : handle.stop] == encode_argument(Variant(VT.I4, 1))
    assert frame.template_match is None


def test_a_layout_is_known_before_anything_else_is_asked() -> None:
    templates = FrameTemplates()
    first, second = (
        Frame(encode_frame(1, 0, 65, [Variant(VT.I8, 1)]), None, templates),
        Frame(encode_frame(2, 0, 65, [Variant(VT.I8, 2)]), None, templates),
    )
    found = [frame.template_match for frame in (first, second)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0][0] is found[1][0]
    assert (found[0][1], found[1][1]) == ((1,), (2,))


def test_a_plain_frame_is_its_own_body() -> None:
    for pair in FRAMES[:-1]:
        assert Frame(pair.data).body == pair.data


@pytest.mark.parametrize(
    ("serial", "reserved", "code", "framing"),
    [
        (-1, 0, 0, Framing.PLAIN),
        (65536, 0, 0, Framing.PLAIN),
        (0, -1, 0, Framing.PLAIN),
        (0, 65536, 0, Framing.PLAIN),
        (0, 0, 2**32, Framing.PLAIN),
        (0, 0, -(2**31) - 1, Framing.PLAIN),
        (0, 0, 1, Framing.VERSION_1),
        (0, 2, 1, Framing.VERSION_1_ZLIB),
    ],
)
def test_refuses_numbers_that_do_not_fit(serial: int, reserved: int, code: int, framing: Framing) -> None:
    with pytest.raises(LocalProtocolError):
        encode_frame(serial, reserved, code, (), framing)


@pytest.mark.parametrize("vt", NUMBER_FORMATS)
@pytest.mark.parametrize("count", [0, 1, 8, 64, 65])
def test_a_row_of_numbers_is_packed_as_any_argument_is(vt: int, count: int) -> None:
    row = Variant.array(vt, tuple(range(count)))
    frame = Frame(encode_frame(7, 8, 0x900, [row]))
    assert (frame.serial, frame.reserved, frame.code, frame.argc) == (7, 8, 0x900, 1)
    assert frame.raw[15:-1] == encode_argument(row)
    assert frame.length == len(frame.raw)
    assert not frame.problems


@pytest.mark.parametrize(
    "row",
    [
        Variant(ARRAY | VT.R8, (1.0, 2.0), 3),
        Variant(ARRAY | VT.R8, (1.0, 2.0), -1),
        Variant(ARRAY | VT.R4, (1e300,), 1),
        Variant(ARRAY | VT.R8, ("1",), 1),
        Variant(ARRAY | VT.I2, (70_000,), 1),
    ],
)
def test_refuses_rows_that_do_not_fit(row: Variant) -> None:
    with pytest.raises(LocalProtocolError, match="cannot be packed"):
        encode_frame(1, 0, 0, [row])


def test_refuses_values_that_do_not_fit() -> None:
    with pytest.raises(LocalProtocolError, match="cannot be packed"):
        encode_frame(1, 0, 64, [Variant(VT.I2, 70_000)])
    with pytest.raises(LocalProtocolError):
        encode_frame(1, 0, 64, [Variant(VT.EMPTY, None)] * 65_536)


def test_a_frame_may_have_16_mib() -> None:
    largest = Variant.array(VT.UI1, bytes(16 * 1024 * 1024 - 26))
    assert len(encode_frame(1, 0, 64, [largest])) == 16_777_216
    with pytest.raises(TooLargeError):
        encode_frame(1, 0, 64, [Variant.array(VT.UI1, bytes(16 * 1024 * 1024 - 25))])


def test_refuses_a_frame_that_is_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames_module, "LARGEST_FRAME", 100)
    largest = Variant.array(VT.UI1, bytes(74))
    assert len(encode_frame(1, 0, 64, [largest])) == 100
    larger = Variant.array(VT.UI1, bytes(75))
    with pytest.raises(LocalProtocolError, match="the limit is 100"):
        encode_frame(1, 0, 64, [larger])
    with pytest.raises(LocalProtocolError, match="the limit is 100"):
        encode_frame(1, 1, 64, [Variant.array(VT.UI1, bytes(1000))], Framing.VERSION_1_ZLIB)


def test_what_may_be_packed_may_be_unpacked() -> None:
    most = contents.LARGEST_UNPACKED - 16
    raw = encode_frame(1, 1, 64, [Variant.array(VT.UI1, bytes(most))], Framing.VERSION_1_ZLIB)
    assert len(raw) < 2000
    assert len(zlib.decompress(raw[13:-2])) == contents.LARGEST_UNPACKED
    assert Frame(raw).problems == ()
    with pytest.raises(TooLargeError):
        encode_frame(1, 1, 64, [Variant.array(VT.UI1, bytes(most + 1))], Framing.VERSION_1_ZLIB)


@given(plans())
def test_what_is_packed_is_read(plan: Plan) -> None:
    raw = encode_frame(*plan)
    frame = only(parse_datagram(raw))
    assert (frame.serial, frame.reserved, frame.code) == plan[:3]
    assert repr([argument.variant for argument in frame.arguments]) == repr(list(map(bare, plan.arguments)))
    assert frame.problems == ()
    assert frame.framing is plan.framing
    check_frame(frame)


@given(st.lists(frames() | mutated_frames() | garbage(), max_size=3).map(b"".join))
def test_any_datagram_is_read(raw: bytes) -> None:
    targets.frame(raw)


@given(st.binary(max_size=300))
def test_any_bytes_are_read(raw: bytes) -> None:
    targets.frame(raw)
    targets.frame(plain_frame(raw.hex(), 3))


@given(st.integers(), st.integers(), st.integers(), st.sampled_from(Framing))
def test_refuses_with_one_error_only(serial: int, reserved: int, code: int, framing: Framing) -> None:
    try:
        raw = encode_frame(serial, reserved, code, (), framing)
    except LocalProtocolError:
        return
    assert Frame(raw).problems == ()
