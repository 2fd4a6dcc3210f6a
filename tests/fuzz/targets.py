"""What is fuzzed, and what must hold for any bytes at all."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator

from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.link_layer import ETHERNET
from bcapscope.capture.packet import Packet
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.frame import Frame, Framing, Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.frame_content import LARGEST_UNPACKED, FrameContent
from bcapscope.protocol.codec.stream_splitter import (
    LARGEST_GARBAGE,
    LARGEST_UNCONFIRMED,
    StreamPiece,
    StreamSplitter,
)
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant
from bcapscope.traffic.observation import Observation
from tests.dumps import packets_in

SMALL_LIMIT = 300
"""A second bound for streams, small enough that short inputs reach it."""


def frame(data: bytes) -> None:
    """Read `data` as a datagram."""
    items = parse_datagram(data)
    assert b"".join(item.raw for item in items) == data
    for item in items:
        if isinstance(item, Malformed):
            assert item.problems
        else:
            check_frame(item)


def check_frame(item: Frame, noted: bool = False) -> None:
    """Compare a frame with one decoded on its own, and what it holds with its bytes.

    Args:
        item: the frame.
        noted: the last of its problems is not from its own bytes.
    """
    fresh = FrameContent(item.raw)
    for _ in range(2):
        assert repr(item.arguments) == repr(fresh.arguments)
        assert (item.problems[:-1] if noted else item.problems) == fresh.problems
        assert item.framing is fresh.framing
    assert repr(item.variants) == repr(tuple(argument.variant for argument in item.arguments))
    assert item.body == fresh.body
    assert len(item.body) <= max(len(item.raw), LARGEST_UNPACKED + 10)
    check_arguments(item.arguments, len(item.body))
    offsets = [problem.offset for problem in fresh.problems]
    assert offsets == sorted(offsets)
    assert not offsets or 0 <= offsets[0] <= offsets[-1] <= len(item.body)
    if not item.problems and item.framing is not Framing.VERSION_1_ZLIB:
        check_encoding(item)


def check_arguments(arguments: tuple[Argument, ...], size: int) -> None:
    """Arguments follow each other, inside the frame, and hold no more than their bytes."""
    stop = 15
    for argument in arguments:
        assert argument.start == stop
        stop = argument.stop
        assert stop - argument.start >= 10
        assert weight(argument.variant) <= stop - argument.start
    assert stop <= size


def weight(variant: Variant) -> int:
    """Bytes that a value takes on the wire at the least, whatever its element count claims."""
    value = variant.value
    if isinstance(value, tuple):
        return 6 + sum(weight(item) if isinstance(item, Variant) else size_of(item) for item in value)
    return 6 + size_of(value)


def size_of(value: object) -> int:
    """Bytes of a plain value at the least."""
    if isinstance(value, str):
        return 4 + len(value.encode("utf-16-le", "surrogatepass"))
    if isinstance(value, bytes):
        return len(value)
    return 0 if value is None else 1


def check_encoding(item: Frame) -> None:
    """A sound frame comes out of `encode_frame` as it was, unless two encodings mean the same value."""
    variants = [argument.variant for argument in item.arguments]
    if not any(map(ambiguous, variants)):
        made = encode_frame(item.serial, item.reserved, item.code, variants, item.framing)
        assert made == item.raw


def ambiguous(variant: Variant) -> bool:
    """Tell values that other bytes express as well: any BOOL but 0 is true, NaN has many forms."""
    base = variant.vt & ~ARRAY
    values: Iterable[Value | Variant] = (
        variant.value if isinstance(variant.value, tuple) else (variant.value,)
    )
    if base == VT.BOOL:
        return True
    if base == VT.VARIANT:
        return any(ambiguous(value) for value in values if isinstance(value, Variant))
    return any(isinstance(value, float) and math.isnan(value) for value in values)


def stream(data: bytes) -> None:
    """Read `data` as a stream: first how to cut it, then its bytes.

    Byte 0 tells whether the stream begins in step (bit 0) and its bound (bit 1), byte 1 how many cuts
    follow; each is a size, and 0 a gap.
    """
    if len(data) < 2:
        return
    in_step, limit = bool(data[0] & 1), (SMALL_LIMIT if data[0] & 2 else 16 * 1024 * 1024)
    cuts, payload = data[2 : 2 + data[1]], data[2 + data[1] :]
    runs = runs_between_gaps(cuts, payload)
    whole = split([[b"".join(run)] for run in runs], in_step, limit)
    assert split(runs, in_step, limit) == whole
    assert split([[bytes((byte,)) for part in run for byte in part] for run in runs], in_step, limit) == whole
    check_pieces(whole, runs)


def runs_between_gaps(cuts: bytes, payload: bytes) -> list[list[bytes]]:
    """Cut `payload`; each run is what stands between two gaps."""
    runs: list[list[bytes]] = [[]]
    pos = 0
    for size in cuts:
        if size:
            runs[-1].append(payload[pos : pos + size])
            pos += size
        else:
            runs.append([])
    runs[-1].append(payload[pos:])
    return runs


def split(runs: list[list[bytes]], in_step: bool, limit: int) -> list[StreamPiece]:
    """Give runs of segments to a splitter, a gap of one byte between two runs."""
    splitter = StreamSplitter(in_step, limit)
    pieces: list[StreamPiece] = []
    for index, run in enumerate(runs):
        if index:
            pieces += splitter.add_gap(1)
        for segment in run:
            pieces += splitter.feed(segment)
            assert splitter.pending_bytes <= max(limit, LARGEST_GARBAGE + LARGEST_UNCONFIRMED)
    return pieces + splitter.close()


def check_pieces(pieces: list[StreamPiece], runs: list[list[bytes]]) -> None:
    """Every byte is in one piece, in order."""
    expected = b"?".join(b"".join(run) for run in runs)
    pos = 0
    for piece in pieces:
        assert piece.start == pos < piece.stop
        pos = piece.stop
        if isinstance(piece.item, Malformed) and piece.item.missing:
            assert piece.item.missing == piece.stop - piece.start
            assert piece.item.raw == b""
        else:
            assert piece.item.raw == expected[piece.start : piece.stop]
        if isinstance(piece.item, Frame):
            check_frame(piece.item, noted=piece.item.external_problem is not None)
    assert pos == len(expected)


def text(data: bytes) -> None:
    """Read `data` as text in which frames were pasted."""
    pasted = data.decode("utf-8", "replace")
    line = 1
    for packet in packets_in(pasted):
        assert line <= packet.line <= 1 + pasted.count("\n") + pasted.count("\r")
        line = packet.line
        assert 0 < len(packet.data) <= len(pasted)
        frame(packet.data)


def capture(data: bytes) -> None:
    """Read `data` as a capture file, from link layer to observations.

    It is read at once, in small reads, and with a VLAN tag put into each Ethernet frame, which takes the
    way for any packet where the first takes the one for simple packets.
    """
    found, broken = observed(CaptureFile(io.BytesIO(data)))
    assert observed(CaptureFile(_Trickle(data))) == (found, broken)
    assert observed(_tagged(CaptureFile(io.BytesIO(data)))) == (found, broken)
    for number, observation in enumerate(found, 1):
        assert observation.number == number
        if isinstance(observation.item, Frame):
            check_frame(observation.item, noted=observation.item.external_problem is not None)


class Seen(Observation):
    """An observation that compares by what its flow says."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Seen) and _shown(self) == _shown(other)

    __hash__ = Observation.__hash__


def _shown(observation: Observation) -> tuple[object, ...]:
    flow = observation.flow
    return (*observation[:3], repr(flow), flow.conversation.server_evidence, *observation[4:])


def observed(packets: Iterable[Packet]) -> tuple[list[Seen], tuple[str, int | None] | None]:
    """Observe `packets`; return what was seen and what ended it early."""
    found: list[Seen] = []
    try:
        for observation in PacketDecoder().decode(packets):
            found.append(Seen(*observation))
    except CaptureError as error:
        return found, (str(error), error.offset)
    return found, None


class _Trickle(io.BytesIO):
    """A pipe that gives a few bytes at a time."""

    def read1(self, size: int | None = -1) -> bytes:
        return super().read1(min(size or 0, 37))


def _tagged(packets: Iterable[Packet]) -> Iterator[Packet]:
    for time, data, original, interface, comments in packets:
        if interface.linktype != ETHERNET or len(data) < 14:
            yield time, data, original, interface, comments
        else:
            tagged = data[:12] + b"\x81\x00\x00\x01" + data[12:]
            yield time, tagged, original + 4, interface, comments
