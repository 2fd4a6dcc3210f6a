"""Streams cut into frames: any cut, any glue, and back into step after garbage."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame, Framing, Malformed, encode_frame
from bcapscope.protocol.codec.stream_splitter import (
    LARGEST_GARBAGE,
    LARGEST_UNCONFIRMED,
    MAX_RESYNC_ARGUMENTS,
    StreamPiece,
    StreamSplitter,
)
from bcapscope.protocol.codec.variant import VT, Variant
from tests.frames import (
    ARGUMENT_IDS,
    ARGUMENTS,
    DAMAGED,
    DAMAGED_IDS,
    FRAME_IDS,
    FRAMES,
    ArgumentPair,
    Damaged,
    FramePair,
    nested,
    plain_frame,
)
from tests.fuzz.targets import check_pieces, split
from tests.strategies import cut, streams

EVERYTHING = b"".join(pair.data for pair in FRAMES)
GOOD = FRAMES[2].data


def feed(segments: Iterable[bytes], in_step: bool = True, limit: int = 16 * 1024 * 1024) -> list[StreamPiece]:
    return split([list(segments)], in_step, limit)


def bytewise(data: bytes) -> list[bytes]:
    return [bytes((byte,)) for byte in data]


def raws(pieces: list[StreamPiece]) -> list[bytes]:
    return [piece.item.raw for piece in pieces]


def sound(pieces: list[StreamPiece]) -> list[bytes]:
    return [piece.item.raw for piece in pieces if isinstance(piece.item, Frame) and not piece.item.problems]


WAYS: list[tuple[str, Callable[[bytes], list[bytes]]]] = [
    ("whole", lambda data: [data]),
    ("byte by byte", bytewise),
    ("by seven", lambda data: [data[at : at + 7] for at in range(0, len(data), 7)]),
]


@pytest.mark.parametrize(("_", "way"), WAYS, ids=[name for name, _ in WAYS])
@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_a_frame_comes_out_once_however_it_came(
    pair: FramePair, _: str, way: Callable[[bytes], list[bytes]]
) -> None:
    assert feed(way(pair.data)) == [StreamPiece(0, len(pair.data), Frame(pair.data))]


@pytest.mark.parametrize(("_", "way"), WAYS, ids=[name for name, _ in WAYS])
def test_glued_frames_come_out_one_by_one(_: str, way: Callable[[bytes], list[bytes]]) -> None:
    pieces = feed(way(EVERYTHING + EVERYTHING))
    assert raws(pieces) == [pair.data for pair in FRAMES] * 2
    check_pieces(pieces, [[EVERYTHING, EVERYTHING]])


def test_a_frame_comes_out_with_its_last_byte() -> None:
    splitter = StreamSplitter()
    for byte in bytewise(GOOD)[:-1]:
        assert splitter.feed(byte) == []
    assert splitter.pending_bytes == len(GOOD) - 1
    assert raws(splitter.feed(GOOD[-1:])) == [GOOD]
    assert splitter.pending_bytes == 0
    assert splitter.close() == []


@pytest.mark.parametrize("first", FRAMES, ids=FRAME_IDS)
def test_two_frames_cut_at_every_offset(first: FramePair) -> None:
    data = first.data + GOOD
    for at in range(len(data) + 1):
        assert raws(feed([data[:at], data[at:]])) == [first.data, GOOD]


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_a_stream_that_breaks_off_says_so(pair: FramePair) -> None:
    for end in range(1, len(pair.data)):
        (piece,) = feed([pair.data[:end]])
        assert (piece.start, piece.stop, piece.item.raw) == (0, end, pair.data[:end])
        assert isinstance(piece.item, Frame) is (end >= 15)
        assert piece.item.problems


def test_one_whole_frame_is_taken_at_once_and_nothing_else() -> None:
    splitter = StreamSplitter()
    assert splitter.feed_whole_frame(GOOD) == Frame(GOOD)
    for other in (b"", GOOD[:-1], GOOD + GOOD, GOOD[:-1] + b"\x05", b"\x02" + GOOD[1:]):
        assert splitter.feed_whole_frame(other) is None
    assert splitter.pending_bytes == 0
    assert splitter.feed(GOOD + GOOD[:5]) == [StreamPiece(len(GOOD), 2 * len(GOOD), Frame(GOOD))]
    assert splitter.feed_whole_frame(GOOD) is None
    assert splitter.feed(GOOD[5:]) == [StreamPiece(2 * len(GOOD), 3 * len(GOOD), Frame(GOOD))]
    assert StreamSplitter(synchronized=False).feed_whole_frame(GOOD) is None
    assert StreamSplitter(limit=len(GOOD) - 1).feed_whole_frame(GOOD) is None
    for shortest in (GOOD, encode_frame(1, 0, 2)):
        assert StreamSplitter(limit=len(shortest)).feed_whole_frame(shortest) == Frame(shortest)


@pytest.mark.parametrize("sample", DAMAGED[4:], ids=DAMAGED_IDS[4:])
def test_a_damaged_frame_between_sound_ones_costs_only_itself(sample: Damaged) -> None:
    for way in (lambda data: [data], bytewise):
        assert raws(feed(way(GOOD + sample.data + GOOD))) == [GOOD, sample.data, GOOD]


@pytest.mark.parametrize("sample", DAMAGED[:4], ids=DAMAGED_IDS[:4])
def test_after_a_frame_without_right_end_the_next_is_found(sample: Damaged) -> None:
    for way in (lambda data: [data], bytewise):
        pieces = feed(way(GOOD + sample.data + GOOD + GOOD))
        assert sound(pieces) == [GOOD] * 3
        assert pieces[1].item.raw == sample.data
        assert pieces[1].item.problems


def test_a_frame_after_garbage_is_returned_once_its_bytes_have_arrived() -> None:
    # The garbage claims 5000 bytes and two arguments; the second argument is impossible.
    garbage = struct.pack("<BIHHIHI6x", 1, 5000, 1, 0, 64, 2, 6)
    splitter = StreamSplitter(synchronized=False)
    assert splitter.feed(garbage) == []
    assert raws(splitter.feed(bytes(4) + GOOD)) == [garbage + bytes(4), GOOD]


def test_a_frame_that_claims_too_many_arguments_comes_out_with_its_last_byte() -> None:
    claiming = GOOD[:13] + bytes((GOOD[13] + 1,)) + GOOD[14:]
    splitter = StreamSplitter()
    assert splitter.feed(claiming[:-1]) == []
    assert raws(splitter.feed(claiming[-1:])) == [claiming]


def test_an_argument_that_is_too_short_brings_no_stream_back_into_step() -> None:
    short = struct.pack("<BIHHIHI5xB", 1, 25, 1, 0, 64, 1, 5, 4)
    assert len(short) == 25
    assert raws(feed([b"?" + short + GOOD])) == [b"?" + short, GOOD]


def test_all_bytes_of_a_length_count() -> None:
    huge = GOOD[:4] + b"\x01" + GOOD[5:]
    assert raws(feed([huge + huge + GOOD])) == [huge + huge, GOOD]


@pytest.mark.parametrize("size", [9, 40])
def test_at_the_end_of_a_stream_only_what_comes_last_is_cut(size: int) -> None:
    broken = GOOD[:1] + (5000).to_bytes(4, "little") + GOOD[5:]
    splitter = StreamSplitter()
    assert splitter.feed(broken + GOOD + GOOD[:size]) == []
    pieces = splitter.close()
    assert raws(pieces) == [broken, GOOD, GOOD[:size]]
    assert [(piece.start, piece.stop) for piece in pieces] == [(0, 82), (82, 164), (164, 164 + size)]
    assert ["cut" in {each.code for each in piece.item.problems} for piece in pieces] == [False, False, True]


@pytest.mark.parametrize(("length", "is_awaited"), [(65_536, True), (65_537, False)])
def test_a_length_that_no_argument_confirms_is_awaited_up_to_64_kib(length: int, is_awaited: bool) -> None:
    claiming = GOOD[:1] + length.to_bytes(4, "little") + GOOD[5:]
    assert (StreamSplitter().feed(claiming + GOOD) == []) is is_awaited


def test_no_more_than_16_kib_are_kept_of_a_long_frame_while_memory_is_scarce() -> None:
    budget = ByteBudget(limit=100)
    splitter = StreamSplitter(budget=budget)
    large = encode_frame(1, 0, 64, [Variant.array(VT.UI1, bytes(30_000))])
    assert splitter.feed(large[:16_384]) == []
    (piece,) = splitter.feed(large[16_384:16_385])
    assert piece.item.raw == large[:16_385]
    assert str(piece.item.problems[-1].reason) == (
        "incomplete: the unfinished frames of all connections exceed 100 bytes"
    )
    assert (splitter.pending_bytes, budget.held) == (0, 0)
    assert raws(splitter.feed(b"\x01" + (10_000).to_bytes(4, "little") + bytes(30) + GOOD))[-1] == GOOD


def test_garbage_cut_at_every_offset_is_the_same_garbage() -> None:
    # The length of the first argument fits the frame only without the last of its four bytes.
    data = struct.pack("<BIHHIHI6xI6xB5x", 1, 36, 1, 0, 64, 2, 0x01000006, 6, 4) + GOOD
    for at in range(len(data) + 1):
        assert raws(feed([data[:at], data[at:]], in_step=False)) == [data[: -len(GOOD)], GOOD]


GARBAGE = [
    b"\x00",
    b"\x01",
    b"\x01" * 40,
    b"\x01\x10\x00\x00\x00" * 9,
    b"\x01\xff\xff\xff\xff" + bytes(11),
    b"\x01\x20\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x03\x00" + bytes(30),
    b"GET / HTTP/1.1\r\n\r\n",
    GOOD[1:],
    GOOD[:-1],
    GOOD[:20],
    bytes(range(256)) * 3,
]


@pytest.mark.parametrize("garbage", GARBAGE, ids=lambda data: data[:12].hex())
@pytest.mark.parametrize("in_step", [True, False])
def test_frames_are_found_behind_garbage(garbage: bytes, in_step: bool) -> None:
    for data in (garbage + GOOD, GOOD + garbage + EVERYTHING, GOOD + GOOD + garbage):
        pieces = feed([data], in_step)
        assert feed(bytewise(data), in_step) == pieces
        check_pieces(pieces, [[data]])
        expected = data.count(GOOD) if EVERYTHING not in data else 1 + len(FRAMES)
        assert len(sound(pieces)) == expected


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_every_kind_of_frame_brings_a_stream_back_into_step(pair: FramePair) -> None:
    pieces = feed([b"\x01\x01?" + pair.data], in_step=False)
    assert raws(pieces) == [b"\x01\x01?", pair.data]
    assert raws(feed([pair.data[1:] + pair.data], in_step=False))[-1] == pair.data


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_every_kind_of_argument_brings_a_stream_back_into_step(pair: ArgumentPair) -> None:
    frame = plain_frame(pair.data.hex())
    assert raws(feed([b"?" + frame], in_step=False)) == [b"?", frame]


def test_after_a_gap_only_a_sound_frame_counts() -> None:
    (sample,) = (sample.data for sample in DAMAGED if sample.name == "argument length too large")
    assert raws(feed([sample + sample + GOOD])) == [sample, sample, GOOD]
    splitter = StreamSplitter()
    pieces = splitter.add_gap(1) + splitter.feed(sample + sample + GOOD)
    assert raws(pieces) == [b"", sample + sample, GOOD]


def _plain(problem: Problem) -> tuple[int, str, str]:
    return problem.offset, problem.code, str(problem.reason)


def test_bytes_outside_of_frames_say_why() -> None:
    pieces = feed([b"??" + GOOD + b"\x01\x02"])
    assert [(piece.start, piece.stop) for piece in pieces] == [(0, 2), (2, 2 + len(GOOD)), (84, 86)]
    assert [_plain(problem) for piece in pieces for problem in piece.item.problems] == [
        (0, "soh", "bytes outside of any frame"),
        (0, "short", "a frame breaks off after 2 bytes"),
        (2, "cut", "the stream ends here"),
    ]


def test_only_the_end_or_a_gap_cuts_a_frame() -> None:
    begun = GOOD[:9]
    found = feed([GOOD + begun + GOOD + begun])
    assert raws(found) == [GOOD, begun, GOOD, begun]
    assert [[problem.code for problem in piece.item.problems] for piece in found] == [
        [],
        ["short"],
        [],
        ["short", "cut"],
    ]
    splitter = StreamSplitter()
    before, hole = splitter.feed(begun) + splitter.add_gap(3)
    assert _plain(before.item.problems[-1]) == (9, "cut", "what follows was not seen")
    assert isinstance(hole.item, Malformed)


def test_a_gap_ends_what_was_begun_and_counts_its_bytes() -> None:
    splitter = StreamSplitter()
    pieces = splitter.feed(GOOD + GOOD[:30])
    pieces += splitter.add_gap(52)
    pieces += splitter.feed(GOOD)
    assert [(piece.start, piece.stop) for piece in pieces] == [(0, 82), (82, 112), (112, 164), (164, 246)]
    begun, hole, after = (piece.item for piece in pieces[1:])
    assert isinstance(begun, Frame)
    assert begun.problems
    assert isinstance(hole, Malformed)
    assert (hole.raw, hole.missing) == (b"", 52)
    assert [*map(_plain, hole.problems)] == [(0, "gap", "52 bytes of the stream were not seen")]
    assert after == Frame(GOOD)


def test_after_a_gap_in_the_middle_of_a_frame_the_next_is_found() -> None:
    for at in range(1, len(GOOD)):
        splitter = StreamSplitter()
        pieces = splitter.add_gap(at) + splitter.feed(GOOD[at:] + GOOD) + splitter.close()
        assert raws(pieces) == [b"", GOOD[at:], GOOD]


def test_a_frame_that_is_whole_at_a_gap_is_not_lost() -> None:
    garbage = b"\x01\x10\x00\x00\x00\x00\x00\x00"
    splitter = StreamSplitter(synchronized=False)
    assert splitter.feed(garbage) == []
    pieces = splitter.feed(GOOD) + splitter.add_gap(1)
    assert raws(pieces) == [garbage, GOOD, b""]


def test_a_closed_stream_may_go_on() -> None:
    splitter = StreamSplitter()
    assert raws(splitter.feed(GOOD[:9]) + splitter.close()) == [GOOD[:9]]
    assert raws(splitter.feed(GOOD) + splitter.close()) == [GOOD]


@pytest.mark.parametrize("filler", [0x00, 0x01, 0xFF])
@pytest.mark.parametrize("extra", [-1, 0, 1, 16])
def test_garbage_comes_out_in_pieces(filler: int, extra: int) -> None:
    data = bytes((filler,)) * (2 * LARGEST_GARBAGE + extra)
    splitter = StreamSplitter(synchronized=False)
    pieces: list[StreamPiece] = []
    for at in range(0, len(data), 1000):
        pieces += splitter.feed(data[at : at + 1000])
        assert splitter.pending_bytes <= LARGEST_GARBAGE + LARGEST_UNCONFIRMED
    pieces += splitter.feed(GOOD) + splitter.close()
    assert pieces == feed([data + GOOD], in_step=False)
    check_pieces(pieces, [[data, GOOD]])
    assert pieces[0].stop == 65_536
    assert sound(pieces) == [GOOD]


def test_a_frame_right_behind_the_largest_piece_of_garbage() -> None:
    for size in range(LARGEST_GARBAGE - 2, LARGEST_GARBAGE + 3):
        data = bytes(size) + GOOD
        pieces = feed([data[:500], data[500:]])
        assert raws(pieces)[-1] == GOOD
        assert len(pieces) == (2 if size <= LARGEST_GARBAGE else 3)


def test_a_large_frame_is_waited_for_only_where_its_arguments_bear_it_out() -> None:
    large = encode_frame(1, 0, 64, [Variant.array(VT.UI1, b"\x01" * 200_000)])
    assert raws(feed([large[at : at + 1460] for at in range(0, len(large), 1460)])) == [large]
    longer = bytearray(large)
    longer[3] += 1
    pieces = StreamSplitter().feed(bytes(longer) + GOOD)
    assert sound(pieces) == [GOOD]
    assert max(piece.stop - piece.start for piece in pieces) <= LARGEST_GARBAGE


def test_a_large_compressed_frame_is_waited_for() -> None:
    noise = b"".join((n * n * 2654435761 % 2**32).to_bytes(4, "little") for n in range(25_000))
    large = encode_frame(1, 1, 64, [Variant.array(VT.UI1, noise)], Framing.VERSION_1_ZLIB)
    assert len(large) > LARGEST_UNCONFIRMED
    assert raws(feed([large[:70_000], large[70_000:] + GOOD])) == [large, GOOD]


def test_a_corrupted_length_costs_a_bounded_wait() -> None:
    broken = GOOD[:1] + (5000).to_bytes(4, "little") + GOOD[5:]
    splitter = StreamSplitter()
    pieces = splitter.feed(broken)
    for _ in range(59):
        pieces += splitter.feed(GOOD)
    assert pieces == []
    assert raws(splitter.feed(GOOD)) == [broken, *[GOOD] * 60]


def test_the_limit_holds_however_the_stream_is_cut() -> None:
    for data in (GOOD + FRAMES[3].data + GOOD, FRAMES[3].data, b"?" + FRAMES[3].data + GOOD):
        pieces = feed([data], limit=len(GOOD))
        assert feed(bytewise(data), limit=len(GOOD)) == pieces
        assert raws(pieces).count(GOOD) == data.count(GOOD)
        check_pieces(pieces, [[data]])
    too_long = FRAMES[3].data
    for front in (b"", b"?"):
        for way in ([front + too_long + too_long + GOOD], [front, too_long, too_long, GOOD]):
            assert raws(feed(way, limit=len(GOOD))) == [front + too_long + too_long, GOOD]


def test_a_shared_budget_counts_what_its_streams_hold() -> None:
    budget = ByteBudget()
    splitters = [StreamSplitter(budget=budget), StreamSplitter(synchronized=False, budget=budget)]
    for segment in bytewise(EVERYTHING + b"garbage" + EVERYTHING):
        for splitter in splitters:
            splitter.feed(segment)
        assert budget.held == sum(splitter.pending_bytes for splitter in splitters)
    splitters[0].add_gap(5)
    assert budget.held == splitters[1].pending_bytes
    splitters[1].close()
    assert budget.held == 0


def test_many_arguments_are_taken_in_step_only() -> None:
    few = encode_frame(1, 0, 64, [Variant(VT.I4, 1)] * MAX_RESYNC_ARGUMENTS)
    many = encode_frame(1, 0, 64, [Variant(VT.I4, 1)] * (MAX_RESYNC_ARGUMENTS + 1))
    assert raws(feed([many + few])) == [many, few]
    assert raws(feed([b"?" + few + many])) == [b"?", few, many]
    assert raws(feed([b"?" + many + few])) == [b"?" + many, few]


def test_nesting_is_no_matter_for_a_stream() -> None:
    deep = nested(2000)
    assert raws(feed(bytewise(deep + GOOD))) == [deep, GOOD]


def test_large_frames_byte_by_byte_and_hostile_streams_take_linear_time() -> None:
    """Each would take hours if bytes were looked at anew with every one that comes."""
    args = encode_frame(1, 0, 64, [Variant(VT.I4, 1)] * 8_000)
    assert len(args) == 112_016
    assert raws(feed(bytewise(args))) == [args]
    header = bytes.fromhex("01 E8FD0000 0000000000000000 0100 D4FD0000")
    walked = bytes.fromhex("01 E8FD0000 0000000000000000 4000") + b"\x06\0\0\0" * 99
    for hostile in (b"\x01" * 100_000, header * 8_000, walked * 300):
        pieces = feed([hostile[at : at + 100] for at in range(0, len(hostile), 100)])
        assert sum(piece.stop - piece.start for piece in pieces) == len(hostile)


@given(st.data(), streams(), st.booleans(), st.sampled_from([60, 300, 16 * 1024 * 1024]))
def test_cutting_never_changes_the_result(
    data: st.DataObject, stream: bytes, in_step: bool, limit: int
) -> None:
    whole = feed([stream], in_step, limit)
    check_pieces(whole, [[stream]])
    assert feed(data.draw(cut(stream)), in_step, limit) == whole
    assert feed(bytewise(stream), in_step, limit) == whole


@given(st.data(), st.lists(streams(), min_size=2, max_size=3))
def test_cutting_never_changes_the_result_between_gaps(data: st.DataObject, runs: list[bytes]) -> None:
    whole = split([[run] for run in runs], True, 16 * 1024 * 1024)
    check_pieces(whole, [[run] for run in runs])
    assert split([data.draw(cut(run)) for run in runs], True, 16 * 1024 * 1024) == whole


def test_a_frame_inside_a_frame_is_none_of_the_stream() -> None:
    outer = encode_frame(1, 0, 64, [Variant.array(VT.UI1, GOOD)])
    for data in (outer, outer[:-1] + b"\x05", outer[:-1] + b"\x05" + GOOD):
        assert raws(feed([data]))[0] == data[: len(outer)]
        assert feed(bytewise(data)) == feed([data])


def test_a_damaged_eot_is_told_from_a_missing_one() -> None:
    for rest in (b"", GOOD, GOOD + GOOD):
        assert raws(feed(bytewise(GOOD[:-1] + b"\x05" + rest)))[0] == GOOD[:-1] + b"\x05"
        assert sound(feed(bytewise(GOOD[:-1] + b"\x05" + rest))) == [GOOD] * (len(rest) // len(GOOD))
        assert sound(feed(bytewise(GOOD[:-1] + rest))) == [GOOD] * (len(rest) // len(GOOD))
    splitter = StreamSplitter()
    assert splitter.feed(GOOD[:-1] + b"\x05") == []
    assert raws(splitter.feed(GOOD[:1])) == [GOOD[:-1] + b"\x05"]


@given(streams())
def test_sound_frames_in_front_are_never_lost(rest: bytes) -> None:
    pieces = feed([EVERYTHING + rest])
    assert raws(pieces)[: len(FRAMES)] == [pair.data for pair in FRAMES]
