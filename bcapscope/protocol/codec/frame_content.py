"""Decode in full what follows the header of a frame: arguments, framing and problems."""

from __future__ import annotations

import struct
import zlib
from binascii import crc_hqx
from enum import Enum
from operator import attrgetter

from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.arguments import Argument, ArgumentReader, NumberSpan, Problem

SOH = 0x01
EOT = 0x04
HEADER_SIZE = 15
SMALLEST_FRAME = 16

LARGEST_FRAME = 16 << 20
"""Largest frame in bytes: the limit of the older C client for TCP (b-Cap.h). Newer libraries have none."""

LARGEST_UNPACKED = 256 << 10
"""Maximum size in bytes of an unpacked body. A malicious zlib stream of 16 KiB could unpack to 16 MiB."""

_HEADER = struct.Struct("<xIHHIH")
_ZLIB_BODY = 13
_SMALLEST_UNPACKED = 6
_OFFSET = attrgetter("offset")


class Framing(Enum):
    """Kind of bytes between the last argument of a frame and EOT."""

    PLAIN = "plain"
    """Nothing."""
    SERIAL_LINE = "serial line"
    """A CRC of two bytes (orin_bcap C/src/bcap_common.c)."""
    VERSION_1 = "version 1"
    """One mode byte with the value 0; the reserved field is 1 (keioku/bcap-python)."""
    VERSION_1_ZLIB = "version 1, zlib"
    """One mode byte with the value 1. At offset 9, the frame holds the unpacked size (u32), then a zlib
    stream of function id, argument count and arguments (keioku/bcap-python).
    """


class FrameContent:
    """The decoded content of a frame that has at least a header; decoding never raises. In a compressed
    frame, the unpacked content replaces the compressed bytes in `body`; the first nine bytes and EOT stay the
    same. The offsets of arguments and problems refer to `body`.
    """

    def __init__(self, raw: bytes) -> None:
        self.framing = Framing.PLAIN
        self.body = self.raw = raw
        length, _, _, self.code, _ = _HEADER.unpack_from(raw)
        head: list[Problem] = []
        if raw[0] != SOH:
            head.append(Problem(0, "soh", Message("problem.soh", byte=f"{raw[0]:02X}")))
        if length != len(raw):
            head.append(Problem(1, "length", Message("problem.length", claimed=length, present=len(raw))))
        unpacked = _decompress(raw) if is_compressed(raw) else None
        if unpacked is not None:
            self.framing = Framing.VERSION_1_ZLIB
            self.body, unpack_problems = unpacked
            head += unpack_problems
            (self.code,) = struct.unpack_from("<I", self.body, 9)
        reader = self._read_arguments()
        self.arguments: tuple[Argument, ...] = tuple(reader.arguments)
        self.number_spans: list[NumberSpan] = reader.number_spans
        self.problems: tuple[Problem, ...] = tuple(sorted((*head, *reader.problems), key=_OFFSET))

    def _read_arguments(self) -> ArgumentReader:
        body = self.body
        has_eot = body[-1] == EOT
        damaged_eot = int.from_bytes(body[1:5], "little") == len(body)
        end = len(body) - 1 if has_eot or damaged_eot else len(body)
        reader = ArgumentReader(body, HEADER_SIZE, end)
        reader.read(int.from_bytes(body[13:15], "little"))
        if reader.pos < end and reader.is_complete:
            self._read_tail(reader)
        if len(body) <= HEADER_SIZE:
            reader.problems.append(Problem(len(body), "eot", Message("problem.eot.missing")))
        elif not has_eot:
            reader.problems.append(
                Problem(len(body) - 1, "eot", Message("problem.eot", byte=f"{body[-1]:02X}"))
            )
        return reader

    def _read_tail(self, reader: ArgumentReader) -> None:
        """Determine the `framing` from the bytes between the last argument and EOT."""
        body, end = self.body, reader.end
        tail = body[reader.pos : end]
        plain = self.framing is Framing.PLAIN
        if plain and tail == b"\x00" and body[7:9] == b"\x01\x00":
            self.framing = Framing.VERSION_1
        elif plain and len(tail) == 2 and tail == crc16(body[1 : end - 2]).to_bytes(2, "little"):
            self.framing = Framing.SERIAL_LINE
        else:
            reason = Message("problem.left-over", bytes=Count(len(tail), "byte"))
            reader.problems.append(Problem(reader.pos, "left-over", reason))


def has_compressed_header(data: bytes | bytearray, pos: int = 0) -> bool:
    """Return whether the frame at `pos` looks like a compressed version 1 frame. An uncompressed frame with
    fewer than 376 arguments never looks like a compressed frame.
    """
    return data[pos + 7 : pos + 9] == b"\x01\x00" and has_zlib_header(data, pos)


def crc16(data: bytes) -> int:
    """Return the CRC-16 of a serial-line frame, over the bytes from the length field to the last argument.

    The CRC has polynomial 0x1021, start value 0xFFFF, no reflection and no final inversion (orin_bcap
    C/src/bcap_common.c and the Java client). In the frame, the low byte of the CRC comes first; EOT follows.
    """
    return crc_hqx(data, 0xFFFF)


def has_zlib_header(data: bytes | bytearray, pos: int = 0) -> bool:
    """Return whether the frame at `pos` has a zlib header where a compressed body begins. The TCP client of
    keioku/bcap-python unpacks every frame with this header, even if the reserved field of the frame is not 1.
    """
    return (
        data[pos + _ZLIB_BODY] & 0x8F == 8
        and int.from_bytes(data[pos + _ZLIB_BODY : pos + HEADER_SIZE], "big") % 31 == 0
    )


def is_compressed(raw: bytes) -> bool:
    """Return whether `raw` is a compressed version 1 frame; `raw` holds at least a header."""
    return len(raw) > HEADER_SIZE + 2 and has_compressed_header(raw) and raw[-2:] == b"\x01\x04"


def compressed_code(raw: bytes) -> int:
    """Return the function id or HRESULT of a compressed frame, without decoding its arguments."""
    unpacked = _decompress(raw)
    body = raw if unpacked is None else unpacked[0]
    return int.from_bytes(body[9:_ZLIB_BODY], "little")


def _decompress(raw: bytes) -> tuple[bytes, list[Problem]] | None:
    """Return the unpacked body and its problems; None if zlib cannot unpack the body."""
    claimed = int.from_bytes(raw[9:_ZLIB_BODY], "little")
    machine = zlib.decompressobj()
    try:
        data = machine.decompress(raw[_ZLIB_BODY:-2], LARGEST_UNPACKED + 1)
    except zlib.error:
        return None
    if len(data) < _SMALLEST_UNPACKED:
        return None
    problems = []
    if len(data) > LARGEST_UNPACKED:
        data = data[:LARGEST_UNPACKED]
        problems.append(
            Problem(_ZLIB_BODY, "unpacked", Message("problem.unpacked.too-large", size=LARGEST_UNPACKED))
        )
    elif not machine.eof:
        problems.append(Problem(_ZLIB_BODY, "unpacked", Message("problem.unpacked.early")))
    elif len(data) != claimed:
        problems.append(
            Problem(9, "unpacked", Message("problem.unpacked.size", claimed=claimed, present=len(data)))
        )
    if machine.unused_data:
        problems.append(Problem(_ZLIB_BODY, "left-over", Message("problem.left-over.compressed")))
    return b"".join((raw[:9], data, raw[-1:])), problems
