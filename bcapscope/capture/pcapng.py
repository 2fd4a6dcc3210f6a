"""Read pcapng capture files, which consist of sections of blocks (draft-ietf-opsawg-pcapng)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.capture.byte_source import ByteSource
from bcapscope.capture.packet import Interface, Packet
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.protocol.text_format import counted

MAGIC = b"\x0a\x0d\x0d\x0a"
"""Type of the section header block, the same in both byte orders."""

BLOCK_LIMIT = 16 * 1024 * 1024
"""Largest block in bytes, as in libpcap (sf-pcapng.c, INITIAL_MAX_BLOCKSIZE)."""

INTERFACES_LIMIT = 65536
"""Maximum number of interfaces per section. The obsolete packet block numbers interfaces with 16 bits."""

LONGEST_NAME = 128
"""At most this many characters of an interface's name are kept."""

COMMENTS_SIZE = 65_535
"""Maximum total size of a packet's comments in bytes. The limit is the maximum size of one pcapng option."""

_SECTION, _INTERFACE, _OBSOLETE, _SIMPLE, _ENHANCED = 0x0A0D0D0A, 1, 2, 3, 6
_END, _COMMENT, _NAME, _RESOLUTION, _OFFSET = 0, 1, 2, 9, 14  # option codes
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_BLOCK_OVERHEAD = 12  # type and length before the body of a block, and the length again after the body
_ENHANCED_SIZE = 32  # size of an enhanced packet block without data and options


class _InterfaceClock(NamedTuple):
    """An interface and its clock. A packet's time in ns since 1970 is ticks * factor // divisor + offset."""

    interface: Interface
    factor: int
    divisor: int
    offset: int
    snaplen: int


def read_pcapng(source: ByteSource) -> Iterator[Packet]:
    """Yield the packets of a capture that begins with a section header block.

    A simple packet block has no time, so its packet gets the time of the previous packet. Raises CaptureError
    if a block is damaged or incomplete.
    """
    section = _Section()
    position = count = time = 0
    data = source.data
    while True:
        end = len(data)
        head, clocks = section.packet_header.unpack_from, section.clocks
        current = epoch = -1
        while position + _ENHANCED_SIZE <= end:  # fast path for enhanced packet blocks without options
            kind, size, number, high, low, kept, original = head(data, position)
            stop = position + size
            if kind != _ENHANCED or size != kept + _ENHANCED_SIZE + 3 & ~3 or stop > end:
                break
            if number != current or high != epoch:
                if number >= len(clocks) or clocks[number].divisor != 1:
                    break
                current, epoch = number, high
                interface, factor, _, offset, _ = clocks[number]
                offset += (high << 32) * factor
            count += 1
            start = position + 28
            position = stop
            time = low * factor + offset
            yield time, data[start : start + kept], original, interface, ()
        try:
            size = section.block_size(data, position)
            packet = section.read_block(data, position, size, time) if size else None
        except CaptureError as damage:
            at = source.offset + position
            raise CaptureError(
                Message("capture.damaged.block", offset=at, packets=count, reason=damage.message), at
            ) from None
        position += size
        if packet is not None:
            count += 1
            time = packet[0]
            yield packet
        if size == 0:
            if not source.advance(position):
                break
            position, data = 0, source.data
    if source.data:
        offset = source.offset
        raise CaptureError(Message("capture.cut-block", offset=offset, packets=count), offset)


class _Section:
    def __init__(self) -> None:
        self.clocks: list[_InterfaceClock] = []
        self._set_byte_order("<")

    def _set_byte_order(self, order: str) -> None:
        self.clocks.clear()
        self._order = order
        self.packet_header = struct.Struct(order + "IIIIIII")

    def _unpack(self, form: str, data: bytes, position: int = 0) -> tuple[int, ...]:
        try:
            return struct.unpack_from(self._order + form, data, position)
        except struct.error:
            raise CaptureError(Message("capture.block.too-small", length=len(data))) from None

    def block_size(self, data: bytes, position: int) -> int:
        """Return the size of the block at `position` in bytes; 0 if `data` does not hold the whole block."""
        there = len(data) - position
        if there < _BLOCK_OVERHEAD:
            return 0
        if data[position : position + 4] == MAGIC:
            order = _ORDERS.get(data[position + 8 : position + 12])
            if order is None:
                raise CaptureError(Message("capture.block.no-byte-order"))
            self._set_byte_order(order)
        (size,) = self._unpack("I", data, position + 4)
        if size < _BLOCK_OVERHEAD or size % 4 or size > BLOCK_LIMIT:
            raise CaptureError(Message("capture.block.length", length=size))
        return size if size <= there else 0

    def read_block(self, data: bytes, position: int, size: int, time: int) -> Packet | None:
        """Return the packet in the block at `position`; None if the block contains no packet. `time` is the
        time of the previous packet, ns since 1970.
        """
        kind, _ = self._unpack("II", data, position)
        body = data[position + 8 : position + size - 4]
        (again,) = self._unpack("I", data, position + size - 4)
        if again != size:
            raise CaptureError(Message("capture.block.two-lengths", first=size, second=again))
        if kind == _SECTION:
            self._check_version(body)
        elif kind == _INTERFACE:
            self._add_interface(body)
        elif kind == _SIMPLE:
            return self._make_simple_packet(body, time)
        elif kind == _ENHANCED:
            number, *rest = self._unpack("IIIII", body)
            return self._make_packet(body, number, rest)
        elif kind == _OBSOLETE:
            number, _, *rest = self._unpack("HHIIII", body)
            return self._make_packet(body, number, rest)
        return None

    def _check_version(self, body: bytes) -> None:
        _, major, minor = self._unpack("IHH", body)
        if major != 1:
            raise CaptureError(Message("capture.block.version", version=f"{major}.{minor}"))

    def _add_interface(self, body: bytes) -> None:
        linktype, _, snaplen = self._unpack("HHI", body)
        if len(self.clocks) == INTERFACES_LIMIT:
            raise CaptureError(Message("capture.block.interfaces", limit=INTERFACES_LIMIT))
        name, factor, divisor, offset = "", 1000, 1, 0
        for code, value in self._options(body, 8):
            if code == _NAME:
                name = value[: 4 * LONGEST_NAME].decode("utf-8", "replace")[:LONGEST_NAME]
            elif code == _RESOLUTION and value:
                factor, divisor = _tick_unit(value[0])
            elif code == _OFFSET:
                offset = self._unpack("q", value)[0] * 1_000_000_000
        self.clocks.append(_InterfaceClock(Interface(linktype, name), factor, divisor, offset, snaplen))

    def _options(self, body: bytes, position: int) -> Iterator[tuple[int, bytes]]:
        while position + 4 <= len(body):
            code, size = self._unpack("HH", body, position)
            if code == _END:
                return
            start = position + 4
            if start + size > len(body):
                raise CaptureError(Message("capture.block.option", length=size, left=len(body) - start))
            yield code, body[start : start + size]
            position = start + (size + 3 & ~3)

    def _clock_of(self, number: int) -> _InterfaceClock:
        if number >= len(self.clocks):
            raise CaptureError(Message("capture.block.no-interface", number=number))
        return self.clocks[number]

    def _make_packet(self, body: bytes, number: int, rest: list[int]) -> Packet:
        interface, factor, divisor, offset, _ = self._clock_of(number)
        high, low, kept, original = rest
        stop = 20 + kept
        if stop > len(body):
            raise CaptureError(Message("capture.block.packet", length=kept, room=len(body) - 20))
        time = (high << 32 | low) * factor // divisor + offset
        return time, body[20:stop], original, interface, self._comments(body, stop + 3 & ~3)

    def _comments(self, body: bytes, position: int) -> tuple[str, ...]:
        found, room, more = [], COMMENTS_SIZE, 0
        for code, value in self._options(body, position):
            if code == _COMMENT:
                room -= len(value)
                if room >= 0:
                    found.append(value.decode("utf-8", "replace"))
                else:
                    more += 1
        return (*found, f"{counted(more, 'comment')} not read") if more else tuple(found)

    def _make_simple_packet(self, body: bytes, time: int) -> Packet:
        clock = self._clock_of(0)
        (original,) = self._unpack("I", body)
        kept = min(original, clock.snaplen or original)
        if kept > len(body) - 4:
            raise CaptureError(Message("capture.block.packet", length=kept, room=len(body) - 4))
        return time, body[4 : 4 + kept], original, clock.interface, ()


def _tick_unit(resolution: int) -> tuple[int, int]:
    """Return factor and divisor that convert ticks to ns, from the interface's option if_tsresol."""
    exponent = resolution & 0x7F
    if resolution & 0x80:
        return 1_000_000_000, 1 << exponent
    return (10 ** (9 - exponent), 1) if exponent <= 9 else (1, 10 ** (exponent - 9))
