"""What a client begins with."""

from __future__ import annotations

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.first_frame import first_frame_stops, is_first_frame_incomplete

ROBOT = Variant(VT.I4, 1)
HALT = encode_frame(1, 0, 70, (ROBOT, Variant(VT.BSTR, "")))
SERVICE_STOP = encode_frame(1, 0, 2)
START = encode_frame(1, 0, 1, (Variant(VT.BSTR, ""),))
MOVE = encode_frame(1, 0, 72, (ROBOT, Variant(VT.I4, 1), Variant(VT.BSTR, "P1"), Variant(VT.BSTR, "")))
LEAVE = encode_frame(1, 0, 64, (ROBOT, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0)))
ENTER = encode_frame(1, 0, 64, (ROBOT, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 2)))


@given(st.integers(0, len(HALT)))
def test_a_frame_is_complete_with_its_last_byte(size: int) -> None:
    assert is_first_frame_incomplete(HALT[:size]) is (size < len(HALT))


@pytest.mark.parametrize("data", [b"x", b"\x00\x01", b"\x01\x05\0\0\0", b"\x01\xff\xff\xff\xff"])
def test_bytes_that_begin_no_frame_are_not_waited_for(data: bytes) -> None:
    assert not is_first_frame_incomplete(data)


def test_a_long_frame_is_not_waited_for_to_its_end() -> None:
    data = b"\x01" + (1 << 20).to_bytes(4, "little")
    assert is_first_frame_incomplete(data.ljust(4095, b"\0"))
    assert not is_first_frame_incomplete(data.ljust(4096, b"\0"))


@pytest.mark.parametrize("data", [HALT, SERVICE_STOP, LEAVE, HALT + MOVE, HALT + b"\x01"])
def test_stops(data: bytes) -> None:
    assert first_frame_stops(data) is True


@pytest.mark.parametrize(
    "data", [b"", START, MOVE, ENTER, MOVE + HALT, HALT[:-1], HALT[:-1] + b"\x05", b"\x01"]
)
def test_no_stops(data: bytes) -> None:
    assert first_frame_stops(data) is False


@pytest.mark.parametrize(("characters", "stops"), [(490, True), (491, False)])
def test_a_stop_has_at_most_1024_bytes(characters: int, stops: bool) -> None:
    data = encode_frame(1, 0, 70, (ROBOT, Variant(VT.BSTR, "x" * characters)))
    assert (len(data) <= 1024) is stops
    assert first_frame_stops(data) is stops


@pytest.mark.parametrize(("size", "stops"), [(984, True), (985, False)])
def test_a_stop_of_1025_bytes_is_too_long(size: int, stops: bool) -> None:
    data = encode_frame(1, 0, 70, (ROBOT, Variant.array(VT.UI1, bytes(size))))
    assert len(data) == size + 40
    assert first_frame_stops(data) is stops


def test_nothing_is_unpacked_to_find_a_stop() -> None:
    body = zlib.compress(HALT[9:-1])
    packed = b"\x01" + (len(body) + 10).to_bytes(4, "little") + HALT[5:7] + b"\x01\x00" + body + b"\x04"
    assert not first_frame_stops(packed)


@given(st.binary(max_size=2000))
def test_any_bytes_give_an_answer(data: bytes) -> None:
    for each in (data, b"\x01" + data, HALT[:15] + data):
        is_first_frame_incomplete(each)
        first_frame_stops(each)
