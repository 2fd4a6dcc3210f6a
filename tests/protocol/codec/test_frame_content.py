"""Frames decoded in full: framing, problems, compressed bodies."""

from __future__ import annotations

import binascii
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec import frame_content as contents
from bcapscope.protocol.codec.frame_content import FrameContent, Framing, has_compressed_header, is_compressed
from bcapscope.protocol.codec.variant import VT, Variant, encode_argument
from tests.frames import (
    DAMAGED,
    DAMAGED_IDS,
    FRAME_IDS,
    FRAMES,
    HANDLE,
    Damaged,
    FramePair,
    bare,
    plain_frame,
    values_of,
)

INNER = bytes.fromhex("40000000 0100") + encode_argument(HANDLE)
"""Function id, argument count and argument of a compressed frame."""


def packed(body: bytes, claimed: int) -> bytes:
    """Frame what stands between the unpacked size and the mode byte of a compressed frame."""
    head = b"\x01" + (15 + len(body)).to_bytes(4, "little") + b"\x07\x00\x01\x00"
    return head + claimed.to_bytes(4, "little") + body + b"\x01\x04"


def marks(content: FrameContent) -> list[tuple[int, str]]:
    return [(problem.offset, problem.code) for problem in content.problems]


def variants_of(content: FrameContent) -> tuple[Variant, ...]:
    return tuple(argument.variant for argument in content.arguments)


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_sound_frames_are_read_without_a_problem(pair: FramePair) -> None:
    content = FrameContent(pair.data)
    assert content.problems == ()
    assert content.framing is pair.framing
    assert content.code == pair.code
    assert repr(variants_of(content)) == repr(tuple(map(bare, pair.arguments)))


@pytest.mark.parametrize("sample", DAMAGED, ids=DAMAGED_IDS)
def test_damaged_frames_say_what_is_wrong_and_where(sample: Damaged) -> None:
    content = FrameContent(sample.data)
    assert tuple(marks(content)) == sample.problems
    assert repr(values_of(variants_of(content))) == repr(sample.values)
    assert content.body == sample.data


@pytest.mark.parametrize("pair", FRAMES, ids=FRAME_IDS)
def test_a_frame_cut_anywhere_has_a_problem(pair: FramePair) -> None:
    for end in range(contents.HEADER_SIZE, len(pair.data)):
        content = FrameContent(pair.data[:end])
        assert "length" in {problem.code for problem in content.problems}
        assert len(content.arguments) <= len(pair.arguments) or pair.framing is Framing.VERSION_1_ZLIB


def test_the_first_byte_is_checked() -> None:
    assert marks(FrameContent(b"\x02" + FRAMES[0].data[1:])) == [(0, "soh")]


@pytest.mark.parametrize("spot", range(1, 27))
def test_a_changed_byte_of_a_serial_line_frame_breaks_its_crc(spot: int) -> None:
    (pair,) = (pair for pair in FRAMES if pair.name == "serial line, I2")
    data = bytearray(pair.data)
    data[spot] ^= 0x10
    content = FrameContent(bytes(data))
    assert content.framing is not Framing.SERIAL_LINE
    assert content.problems


def test_an_odd_count_hides_neither_framing_nor_what_is_left_over() -> None:
    argument = bytes.fromhex("0A000000 0300 03000000 07000000")
    head = bytes.fromhex("20000000 0100 0000 02000000 0100") + argument
    crc = binascii.crc_hqx(head, 0xFFFF).to_bytes(2, "little")
    content = FrameContent(b"\x01" + head + crc + b"\x04")
    assert content.framing is Framing.SERIAL_LINE
    assert marks(content) == [(21, "count")]
    assert marks(FrameContent(plain_frame(argument.hex() + "FFFF"))) == [(21, "count"), (29, "left-over")]


def test_problems_stand_in_the_order_of_the_bytes() -> None:
    content = FrameContent(plain_frame("0F000000 0800 03000000 03000000 4100 42")[:-1] + b"\x05")
    assert marks(content) == [
        (15, "argument-length"),
        (21, "count"),
        (25, "string"),
        (32, "eot"),
    ]


def test_a_mode_byte_needs_reserved_1() -> None:
    (pair,) = (pair for pair in FRAMES if pair.framing is Framing.VERSION_1)
    other = pair.data[:7] + b"\x02\x00" + pair.data[9:]
    assert marks(FrameContent(other)) == [(29, "left-over")]
    assert FrameContent(other).framing is Framing.PLAIN


def test_a_compressed_frame_is_read_as_what_it_unpacks_to() -> None:
    raw = packed(zlib.compress(INNER), len(INNER))
    content = FrameContent(raw)
    assert content.framing is Framing.VERSION_1_ZLIB
    assert content.body == raw[:9] + INNER + b"\x04"
    assert [(argument.start, argument.stop) for argument in content.arguments] == [(15, 29)]
    assert (content.code, content.problems) == (64, ())


@pytest.mark.parametrize("level", [0, 1, 6, 9])
def test_every_level_of_compression_is_recognised(level: int) -> None:
    assert FrameContent(packed(zlib.compress(INNER, level), len(INNER))).problems == ()


def test_a_compressed_frame_may_have_no_argument() -> None:
    inner = INNER[:4] + b"\0\0"
    content = FrameContent(packed(zlib.compress(inner), len(inner)))
    assert (content.framing, content.code, content.problems) == (Framing.VERSION_1_ZLIB, 64, ())


def test_a_wrong_unpacked_size_is_told() -> None:
    content = FrameContent(packed(zlib.compress(INNER), 99))
    assert marks(content) == [(9, "unpacked")]
    assert variants_of(content) == (HANDLE,)


def test_bytes_behind_the_compressed_ones_are_told() -> None:
    assert marks(FrameContent(packed(zlib.compress(INNER) + b"?", len(INNER)))) == [(13, "left-over")]


@pytest.mark.parametrize("tail", [b"\0", b"\x5a\x7d", b"???"])
def test_bytes_behind_the_unpacked_arguments_are_told(tail: bytes) -> None:
    content = FrameContent(packed(zlib.compress(INNER + tail), len(INNER + tail)))
    assert marks(content) == [(29, "left-over")]
    assert content.framing is Framing.VERSION_1_ZLIB


def test_compressed_bytes_that_end_early_are_read_as_far_as_they_go() -> None:
    pose = INNER[:4] + b"\x02\x00" + INNER[6:] + encode_argument(Variant.array(VT.UI1, bytes(200)))
    machine = zlib.compressobj()
    flushed = machine.compress(pose) + machine.flush(zlib.Z_SYNC_FLUSH)
    content = FrameContent(packed(flushed, len(pose)))
    assert marks(content) == [(13, "unpacked")]
    assert values_of(variants_of(content)) == (1, bytes(200))


def test_what_unpacks_to_too_little_is_read_as_a_plain_frame() -> None:
    content = FrameContent(packed(zlib.compress(b"12345"), 5))
    assert content.framing is Framing.PLAIN
    assert marks(content)[0] == (15, "argc") or content.problems


def test_damaged_compressed_bytes_are_read_as_a_plain_frame_with_problems() -> None:
    data = bytearray(zlib.compress(INNER))
    data[-1] ^= 1
    content = FrameContent(packed(bytes(data), len(INNER)))
    assert content.framing is Framing.PLAIN
    assert content.problems


@pytest.mark.parametrize("size", [1, 50])
def test_a_zlib_bomb_is_cut(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contents, "LARGEST_UNPACKED", 1000)
    inner = INNER[:6] + bytes.fromhex("00000100 1120 FAFF0000") + bytes(size * 1000)
    content = FrameContent(packed(zlib.compress(inner), len(inner)))
    (problem,) = (problem for problem in content.problems if problem.code == "unpacked")
    assert str(problem.reason) == "unpacks to over 1000 bytes, cut there"
    assert len(content.body) == 10 + 1000


def test_a_body_as_large_as_may_be_is_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contents, "LARGEST_UNPACKED", len(INNER))
    assert FrameContent(packed(zlib.compress(INNER), len(INNER))).problems == ()


def test_no_plain_frame_of_few_arguments_looks_compressed() -> None:
    found = [argc for argc in range(65536) if has_compressed_header(_header(argc))]
    assert min(found) == 376
    assert not any(has_compressed_header(_header(argc, reserved=0)) for argc in found)


def _header(argc: int, reserved: int = 1) -> bytes:
    return b"\x01" + bytes(6) + reserved.to_bytes(2, "little") + bytes(4) + argc.to_bytes(2, "little")


def test_looks_zlib_takes_short_bytes() -> None:
    raw = packed(zlib.compress(INNER), len(INNER))
    assert [end for end in range(len(raw) + 1) if is_compressed(raw[:end])] == [len(raw)]


def test_a_header_alone_has_neither_eot_nor_arguments() -> None:
    for size in (15, 16):
        raw = b"\x01" + size.to_bytes(4, "little") + bytes(8) + b"\x00\x04"
        assert marks(FrameContent(raw)) == ([(1, "length")] if size == 16 else []) + [
            (15, "argc"),
            (15, "eot"),
        ]


def test_a_compressed_frame_has_room_for_its_bytes() -> None:
    content = FrameContent(_header(0x9C78) + b"\x01\x04")
    assert (content.framing, marks(content)) == (Framing.PLAIN, [(1, "length"), (15, "argc")])


def test_no_more_than_256_kib_are_unpacked() -> None:
    for size in (262_144, 262_145):
        inner = INNER[:6] + bytes.fromhex("00000100 1120 FAFF0000") + bytes(size - 16)
        problems = [code for _, code in marks(FrameContent(packed(zlib.compress(inner), size)))]
        assert ("unpacked" in problems) is (size > 262_144)


def test_the_last_byte_of_a_frame_is_its_eot_if_its_length_says_so() -> None:
    for top, problems in ((0, [(15, "eot")]), (1, [(1, "length"), (15, "left-over"), (15, "eot")])):
        raw = b"\x01" + bytes([16, 0, 0, top]) + bytes(11)
        assert marks(FrameContent(raw)) == problems


@given(st.binary(min_size=15, max_size=200))
def test_any_bytes_that_hold_a_header_are_taken_apart(raw: bytes) -> None:
    content = FrameContent(raw)
    assert content.problems or (raw[0], raw[-1]) == (1, 4)
    assert all(0 <= problem.offset <= len(content.body) for problem in content.problems)
