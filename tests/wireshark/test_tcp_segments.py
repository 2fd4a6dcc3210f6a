"""The dissector shows each frame of a TCP stream once, wherever the segments begin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.stream_splitter import LARGEST_GARBAGE, StreamSplitter
from bcapscope.protocol.codec.variant import VT, Variant
from tests import strategies
from tests.wireshark.lua_runtime import VERSIONS, dissector_functions
from tests.wireshark.packets import tcp_packets, write_capture
from tests.wireshark.tshark import Record, dissected, needs_tshark

_SOUND = encode_frame(7, 0, 1)
_DAMAGED_END = encode_frame(8, 0, 3, [Variant(VT.BSTR, "abc")])[:-1] + b"\xa3"
_DAMAGED_LENGTH = b"\x01\x80" + _SOUND[2:]
_UNCONFIRMED = b"\x01\x1f" + _SOUND[2:13] + b"\x01\x00" + _SOUND
"""A frame with a sound frame where its argument should be; in garbage, only the sound frame counts."""

_SEGMENTS = {
    "damaged end": [_DAMAGED_END, _SOUND[:2], _SOUND[2:]],
    "damaged end, then a frame in many segments": [_DAMAGED_END, *(bytes([each]) for each in _SOUND)],
    "damaged end of two frames": [_DAMAGED_END, _DAMAGED_END, _SOUND[:9], _SOUND[9:] + _SOUND],
    "damaged length": [_DAMAGED_LENGTH + _SOUND * 6, _SOUND[:8], _SOUND[8:12], _SOUND[12:14], _SOUND[14:]],
    "no frame unfinished": [_DAMAGED_END, _SOUND, _SOUND],
    "unfinished at the end": [_DAMAGED_END, _SOUND[:2]],
}

_SPLIT = """
return function()
    local stream = new_stream()
    return function(raw)
        local pieces, rest, done = continue_stream(stream, raw)
        local shown = {}
        for _, piece in ipairs(pieces) do
            if piece.at >= done then shown[#shown + 1] = piece.size end
        end
        return table.concat(shown, " "), rest
    end
end
"""


@pytest.mark.parametrize("options", [(), ("-2",)], ids=["one pass", "two passes"])
@pytest.mark.parametrize("segments", _SEGMENTS.values(), ids=_SEGMENTS)
@needs_tshark
def test_tshark_shows_each_frame_once(
    segments: Sequence[bytes], options: Sequence[str], script: Path, tmp_path: Path
) -> None:
    capture = write_capture(tmp_path / "a.pcap", tcp_packets(True, segments, 40_000))
    shown = dissected(script, capture, *options)
    pieces = StreamSplitter().feed(b"".join(segments))
    assert [each["size"] for each in shown] == [piece.stop - piece.start for piece in pieces]


@needs_tshark
def test_replies_belong_to_requests_before_segments_that_wireshark_repeats(
    script: Path, tmp_path: Path
) -> None:
    """Packet 4 shows the request in the first pass, and packet 5 in the second."""
    segments = _SEGMENTS["damaged end"]
    requests = tcp_packets(True, segments, 40_000)
    reply = tcp_packets(False, [encode_frame(8, 0, 0)], 40_000)[2:]
    capture = write_capture(tmp_path / "a.pcap", [*requests, *reply])

    def linked(*options: str) -> list[Record]:
        return [each for each in dissected(script, capture, *options) if each["serial"] == 8]

    request, answer = linked()
    assert (request["packet"], answer["response_to"]) == (4, 4)
    request, answer = linked("-2")
    assert (request["packet"], request["response_in"], answer["response_to"]) == (5, 6, 4)


def _passed_by_wireshark(call: Callable[[bytes], tuple[bytes, int]], segments: Sequence[bytes]) -> list[int]:
    """Pass segments as Wireshark's desegmentation does, and return the sizes of the pieces.

    Wireshark passes the bytes that the dissector leaves again, with the next segment after them. If the
    dissector leaves bytes of earlier segments, Wireshark passes everything again that it has just passed.
    """
    sizes: list[int] = []
    waiting = b""
    for segment in filter(None, segments):
        data = waiting + segment
        shown, rest = call(data)
        sizes += map(int, shown.split())
        is_repeated = waiting and 0 < rest <= len(waiting) and rest < len(data)
        waiting = data if is_repeated else data[rest:]
    return sizes


_ODD_FRAMES = st.sampled_from([_DAMAGED_END, _DAMAGED_LENGTH, _UNCONFIRMED, _SOUND])
_FRAMES = st.one_of(
    _ODD_FRAMES, _ODD_FRAMES, strategies.frames(), strategies.mutated_frames(), strategies.garbage()
)


@st.composite
def _segmented(draw: st.DrawFn) -> list[bytes]:
    """Draw a stream in segments, of which most begin at a frame or near one."""
    frames = draw(st.lists(_FRAMES, min_size=1, max_size=4))
    stream = b"".join((*frames, _SOUND, _SOUND))
    borders = [piece.start for piece in StreamSplitter().feed(stream)]
    wanted = draw(st.lists(st.integers(0, len(stream)), max_size=3))
    for border in borders:
        wanted += [border + each for each in draw(st.sets(st.sampled_from([-1, 0, 1, 9]), max_size=3))]
    cuts = sorted(each for each in wanted if 0 < each < len(stream))
    return [stream[start:stop] for start, stop in pairwise((0, *cuts, len(stream)))]


@cache
def _new_streams(version: str) -> Any:
    """Return a Lua function that starts a stream."""
    return dissector_functions(version, _SPLIT)


def _assert_each_piece_once(new_stream: Any, segments: Sequence[bytes]) -> None:
    pieces = StreamSplitter().feed(b"".join(segments))
    sizes = [piece.stop - piece.start for piece in pieces]
    assert _passed_by_wireshark(new_stream(), segments) == sizes
    by_segment = StreamSplitter()
    assert [piece for segment in segments for piece in by_segment.feed(segment)] == pieces


@pytest.mark.parametrize("version", VERSIONS)
def test_each_piece_is_shown_once(version: str) -> None:
    new_stream = _new_streams(version)
    for segments in _SEGMENTS.values():
        _assert_each_piece_once(new_stream, segments)


@pytest.mark.parametrize("size", [LARGEST_GARBAGE - 1, LARGEST_GARBAGE, LARGEST_GARBAGE + 1])
@pytest.mark.parametrize("start", [_DAMAGED_END, _UNCONFIRMED, _SOUND])
@pytest.mark.parametrize("cut", [None, -1, 0, 1, 20])
def test_garbage_of_the_largest_size_ends_alike(size: int, start: bytes, cut: int | None) -> None:
    stream = bytes(size) + start + _SOUND + _SOUND
    segments = [stream] if cut is None else [stream[: size + cut], stream[size + cut :]]
    _assert_each_piece_once(_new_streams("lua54"), segments)


@pytest.mark.timeout(1800)
@settings(max_examples=5 * settings().max_examples)
@given(_segmented())
def test_each_piece_of_generated_segments_is_shown_once(segments: list[bytes]) -> None:
    _assert_each_piece_once(_new_streams("lua54"), segments)
