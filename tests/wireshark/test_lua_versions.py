"""The decoder of the dissector gives the same results in each Lua that Wireshark uses."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.wireshark.dissector import dissector_text
from tests.wireshark.compressed import compressed_frames
from tests.wireshark.corpus import corpus
from tests.wireshark.lua_runtime import VERSIONS, dissector_functions, lua_runtime

_DESCRIBE = """
local function add(lines, ...) lines[#lines + 1] = table.concat({ ... }, " ") end
local function decode(raw)
    local frame, lines = decode_frame(raw), {}
    add(lines, frame.serial, frame.reserved, frame.code, frame.argc, frame.framing)
    for _, node in ipairs(frame.arguments) do add(lines, node.start, node.stop, node.vt, node.count) end
    for _, problem in ipairs(frame.problems) do add(lines, problem.offset, problem.code, problem.reason) end
    return table.concat(lines, "\\n")
end
local function split(raw, is_stream)
    local lines = {}
    local pieces = (is_stream and split_stream or split_datagram)(raw)
    for _, piece in ipairs(pieces) do add(lines, piece.at, piece.size) end
    return table.concat(lines, "\\n")
end
return decode, split
"""


def _lines(*rows: tuple[object, ...]) -> str:
    return "\n".join(" ".join(map(str, row)) for row in rows)


def _decoded(raw: bytes) -> str:
    frame = Frame(raw)
    return _lines(
        (frame.serial, frame.reserved, frame.code, frame.argc, frame.framing.value),
        *((each.start, each.stop, each.variant.vt, each.variant.elements) for each in frame.arguments),
        *((each.offset, each.code, str(each.reason)) for each in frame.problems),
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_frames_are_decoded_alike(version: str) -> None:
    decode, _ = dissector_functions(version, _DESCRIBE)
    frames = [data for data in corpus("mutated_frames", 1000) if len(data) >= 15]
    serial_line = encode_frame(
        7, 0, 64, [Variant(VT.UI1 | ARRAY, bytes(range(256)), 256)], Framing.SERIAL_LINE
    )
    assert "serial line" in _decoded(serial_line)
    for raw in (serial_line, *frames, *compressed_frames(600)):
        assert decode(raw).decode() == _decoded(raw)


@pytest.mark.parametrize("version", VERSIONS)
def test_streams_and_datagrams_are_split_alike(version: str) -> None:
    _, split = dissector_functions(version, _DESCRIBE)
    for raw in corpus("streams", 500):
        pieces = StreamSplitter().feed(raw)
        assert split(raw, True).decode() == _lines(*((each.start, each.stop - each.start) for each in pieces))
        sizes = [len(item.raw) for item in parse_datagram(raw)]
        assert split(raw, False).decode() == _lines(
            *((sum(sizes[:index]), size) for index, size in enumerate(sizes))
        )


@pytest.mark.parametrize("version", VERSIONS)
def test_the_whole_dissector_compiles(version: str) -> None:
    loaded = lua_runtime(version).eval(b"load")(dissector_text().encode())
    assert not isinstance(loaded, tuple), loaded
