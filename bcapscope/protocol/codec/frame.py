"""The b-CAP frame. `Frame` decodes the header at once, and the arguments when they are first used.

Offsets, all numbers little-endian (orin_bcap C/src/bcap_common.c; DENSO Wave 2009, "How to use the Slave
mode"):

* 0: SOH, 0x01
* 1: u32 length of the whole frame
* 5: u16 serial
* 7: u16 reserved
* 9: u32 function id of a request, HRESULT of a reply
* 13: u16 argument count
* 15: arguments
* last byte: EOT, 0x04
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

from bcapscope.errors import LocalProtocolError, TooLargeError
from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.arguments import Argument, Problem
from bcapscope.protocol.codec.frame_content import (
    EOT,
    HEADER_SIZE,
    LARGEST_FRAME,
    LARGEST_UNPACKED,
    SMALLEST_FRAME,
    SOH,
    Framing,
    compressed_code,
    crc16,
    is_compressed,
)
from bcapscope.protocol.codec.frame_template import FrameNumbers, FrameTemplate, FrameTemplates
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_ARRAYS, NUMBER_FORMATS, Variant, encode_argument

__all__ = [
    "EOT",
    "HEADER_SIZE",
    "LARGEST_FRAME",
    "LARGEST_UDP_FRAME",
    "SMALLEST_FRAME",
    "SOH",
    "Frame",
    "Framing",
    "Malformed",
    "Problem",
    "encode_frame",
    "parse_datagram",
    "with_serial_and_reserved",
]

LARGEST_UDP_FRAME = 503
"""Size in bytes of the largest frame over UDP or a serial line (orin_bcap C/include/dn_udp.h)."""

_SERIAL_RESERVED_CODE = struct.Struct("<5xHHI").unpack_from
_SERIAL_RESERVED = struct.Struct("<HH")
_HEADER = struct.Struct("<BIHHIH").pack
_SIGNED_HEADER = struct.Struct("<BIHHiH").pack

_PLAIN = Framing.PLAIN
# maximum length of a row of numbers for which a packer is cached; longer rows vary too much in length
_LONGEST_PACKED_ROW = 64


@dataclass(frozen=True, slots=True)
class Malformed:
    """Bytes that are not a frame, or a gap in a stream; `missing` is the number of bytes in the gap."""

    raw: bytes
    problems: tuple[Problem, ...]
    missing: int = 0


class Frame:
    """A frame whose header is complete; everything after the header may be damaged.

    No field of a frame shows whether the frame is a request or a reply. In a frame from the client, `code` is
    a function number; in a frame from the controller, `code` is a result code.

    A frame holds only its bytes, so that many stored frames need little memory. `arguments` and `variants`
    decode the bytes each time. Decoding is fast because the frames of a capture share one `FrameTemplates`
    object.

    Attributes:
        raw: The bytes of the frame as received.
        serial: Serial that the client chose; the controller copies it into the reply.
        reserved: Reserved field; clients use it to mark retries over UDP.
        code: Function id of a request, or HRESULT of a reply; unsigned.
        external_problem: A problem that the frame's bytes do not show, such as a packet that the capture
            truncated; None for nearly all frames.
    """

    __slots__ = ("_templates", "code", "external_problem", "raw", "reserved", "serial")

    serial: int
    reserved: int
    code: int

    def __init__(
        self, raw: bytes, external_problem: Problem | None = None, templates: FrameTemplates | None = None
    ) -> None:
        """Read the header of `raw`, which holds at least `HEADER_SIZE` bytes.

        If similar frames share `templates`, only one of these frames is decoded in full. Without `templates`,
        the frame creates its own `FrameTemplates` when you first read its arguments, and keeps the decoded
        arguments.
        """
        self._templates = templates
        self.raw = raw
        self.external_problem = external_problem
        self.serial, self.reserved, self.code = _SERIAL_RESERVED_CODE(raw)
        if self.reserved == 1 and is_compressed(raw):
            self.code = compressed_code(raw)

    def _own_templates(self) -> FrameTemplates:
        self._templates = FrameTemplates()
        return self._templates

    def __repr__(self) -> str:
        return f"Frame({self.raw.hex()!r})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Frame):
            return NotImplemented
        return (self.raw, self.external_problem) == (other.raw, other.external_problem)

    def __hash__(self) -> int:
        return hash(self.raw)

    @property
    def length(self) -> int:
        """Value of the length field, which may differ from the number of bytes in `raw`."""
        return int.from_bytes(self.raw[1:5], "little")

    @property
    def argc(self) -> int:
        """Number of arguments, as the header states it."""
        return int.from_bytes(self.body[13:15], "little")

    @property
    def template_match(self) -> tuple[FrameTemplate, FrameNumbers] | None:
        """The template of this frame and the frame's own numbers; None for a frame without a template.

        Frames with problems and frames longer than `LARGEST_TEMPLATE_FRAME` have no template. For millions of
        frames, `template_match` is faster than `arguments`, because `arguments` creates an object for each
        value.
        """
        if self.external_problem is not None:
            return None
        inner = (self._templates or self._own_templates()).decode(self.raw)
        return inner if isinstance(inner, tuple) else None

    @property
    def arguments(self) -> tuple[Argument, ...]:
        """The arguments of the frame, with their positions as offsets in `body`."""
        inner = (self._templates or self._own_templates()).decode(self.raw)
        return inner[0].fill_arguments(inner[1]) if isinstance(inner, tuple) else inner.arguments

    @property
    def variants(self) -> tuple[Variant, ...]:
        """The values of the arguments, without their positions."""
        inner = (self._templates or self._own_templates()).decode(self.raw)
        if isinstance(inner, tuple):
            return inner[0].fill_variants(inner[1])
        return tuple(argument.variant for argument in inner.arguments)

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Violations of b-CAP in the frame; empty for a valid frame."""
        inner = (self._templates or self._own_templates()).decode(self.raw)
        own = () if isinstance(inner, tuple) else inner.problems
        return own if self.external_problem is None else (*own, self.external_problem)

    @property
    def framing(self) -> Framing:
        """Kind of bytes between the last argument and EOT."""
        inner = (self._templates or self._own_templates()).decode(self.raw)
        return Framing.PLAIN if isinstance(inner, tuple) else inner.framing

    @property
    def body(self) -> bytes:
        """The bytes of the frame, with unpacked content instead of compressed bytes."""
        inner = (self._templates or self._own_templates()).decode(self.raw)
        return self.raw if isinstance(inner, tuple) else inner.body


def parse_datagram(raw: bytes, templates: FrameTemplates | None = None) -> tuple[Frame | Malformed, ...]:
    """Split a datagram into its frames, or into bytes that are not a frame.

    Bytes that begin with SOH and hold a header become a `Frame`, even if they are damaged. If a frame ends
    with EOT before the datagram ends, the result has further items for the bytes after the frame.
    """
    if int.from_bytes(raw[1:5], "little") == len(raw):
        return (parse_single_frame(raw, templates),)
    items: list[Frame | Malformed] = []
    pos = 0
    while True:
        length = int.from_bytes(raw[pos + 1 : pos + 5], "little")
        stop = pos + length
        if not SMALLEST_FRAME <= length < len(raw) - pos or raw[pos] != SOH or raw[stop - 1] != EOT:
            items.append(parse_single_frame(raw[pos:], templates))
            return tuple(items)
        items.append(Frame(raw[pos:stop], None, templates))
        pos = stop


def parse_captured_datagram(
    raw: bytes, templates: FrameTemplates | None = None
) -> tuple[Frame | Malformed, ...]:
    """Split a captured datagram into its frames. If bytes follow the first frame, add a problem to the frame:
    such bytes stop the UDP service of DENSO's C server (orin_bcap C/src/bCAPServer/bcap_server.c).
    """
    items = parse_datagram(raw, templates)
    if len(items) == 1:
        return items
    first, *others = items
    size = len(first.raw)
    reason = Message("problem.length.datagram", claimed=size, present=len(raw))
    return (Frame(first.raw, Problem(size, "length", reason), templates), *others)


def parse_single_frame(raw: bytes, templates: FrameTemplates | None = None) -> Frame | Malformed:
    """Return `raw` as a `Frame` if it begins with SOH and holds a header, otherwise as `Malformed`."""
    if len(raw) >= HEADER_SIZE and raw[0] == SOH:
        return Frame(raw, None, templates)
    if raw[:1] != b"\x01":
        reason = Message("problem.soh", byte=f"{raw[0]:02X}") if raw else Message("problem.soh.no-bytes")
        return Malformed(raw, (Problem(0, "soh", reason),))
    reason = Message("problem.short", bytes=Count(len(raw), "byte"), least=SMALLEST_FRAME)
    return Malformed(raw, (Problem(0, "short", reason),))


def encode_frame(
    serial: int,
    reserved: int,
    code: int,
    arguments: Sequence[Variant] = (),
    framing: Framing = Framing.PLAIN,
) -> bytes:
    """Return the bytes of a frame; `code` may be signed or unsigned.

    `reserved` must be 1 for `Framing.VERSION_1` and `Framing.VERSION_1_ZLIB`.

    Raises:
        TooLargeError: The frame is longer than `LARGEST_FRAME`, or its unpacked content exceeds
            `LARGEST_UNPACKED`.
        LocalProtocolError: A number of the header or the value of an argument is outside the range of its
            field.
    """
    if len(arguments) == 1 and framing is _PLAIN:
        raw = _encode_number_row(serial, reserved, code, *arguments)
        if raw is not None:
            return raw
    packed = b"".join(map(encode_argument, arguments))
    length = SMALLEST_FRAME + len(packed)
    try:
        header = (_SIGNED_HEADER if code < 0 else _HEADER)(
            SOH, length, serial, reserved, code, len(arguments)
        )
    except struct.error as error:
        raise LocalProtocolError(
            Message("frame.bad-header", serial=serial, reserved=reserved, code=code, reason=str(error))
        ) from error
    raw = header + packed + b"\x04"
    if framing is not _PLAIN:
        raw = _apply_framing(raw, framing, reserved)
        length = max(length, len(raw))
    if length > LARGEST_FRAME:
        raise TooLargeError(Message("frame.too-large", size=length, limit=LARGEST_FRAME))
    return raw


def _encode_number_row(serial: int, reserved: int, code: int, row: Variant) -> bytes | None:
    """Encode a frame whose only argument is a short array of numbers, such as a reply to slvMove."""
    vt, values, count = row
    if (
        vt not in NUMBER_ARRAYS
        or not isinstance(values, tuple)
        or not len(values) == count <= _LONGEST_PACKED_ROW
    ):
        return None
    try:
        pack, length, size = _packer(vt, count)
        return pack(SOH, length, serial, reserved, code, 1, size, vt, count, *values, EOT)
    except (struct.error, TypeError, OverflowError):
        return None


@lru_cache(maxsize=256)
def _packer(vt: int, count: int) -> tuple[Callable[..., bytes], int, int]:
    """Return the packing function, the frame size and the argument size for a frame with `count` numbers."""
    whole = struct.Struct(f"<BIHHIHIHI{count}{NUMBER_FORMATS[vt & ~ARRAY]}B")
    return whole.pack, whole.size, whole.size - SMALLEST_FRAME - 4


def with_serial_and_reserved(raw: bytes, serial: int, reserved: int) -> bytes:
    """Return a copy of a frame, which must be `Framing.PLAIN`, with another serial and reserved field."""
    return raw[:5] + _SERIAL_RESERVED.pack(serial, reserved) + raw[9:]


def _apply_framing(plain: bytes, framing: Framing, reserved: int) -> bytes:
    numbers, inner = plain[5:9], plain[9:-1]
    if framing is Framing.SERIAL_LINE:
        checked = (len(plain) + 2).to_bytes(4, "little") + numbers + inner
        return plain[:1] + checked + crc16(checked).to_bytes(2, "little") + plain[-1:]
    if reserved != 1:
        raise LocalProtocolError(Message("frame.version-1-reserved", reserved=reserved))
    body = inner + b"\x00"
    if framing is Framing.VERSION_1_ZLIB:
        if len(inner) > LARGEST_UNPACKED:
            raise TooLargeError(Message("frame.too-large", size=len(inner), limit=LARGEST_UNPACKED))
        body = len(inner).to_bytes(4, "little") + zlib.compress(inner) + b"\x01"
    return plain[:1] + (10 + len(body)).to_bytes(4, "little") + numbers + body + plain[-1:]
