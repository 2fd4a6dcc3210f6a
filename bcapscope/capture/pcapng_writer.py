"""Write packets as pcapng (draft-ietf-opsawg-pcapng), with comments and users' notes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias

from bcapscope.capture.append_log import ByteSink, write_all
from bcapscope.capture.packet import Interface, Packet

_SECTION_BLOCK, _INTERFACE_BLOCK, _PACKET_BLOCK = 0x0A0D0D0A, 1, 6
_SECTION = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
_HEAD, _SIZE = struct.Struct("<IIIIIII"), struct.Struct("<I")
_WORD = 0xFFFFFFFF
_PADDING = b"", b"\0\0\0", b"\0\0", b"\0"
"""Padding that extends data to a multiple of four bytes; the index is the data's size modulo four."""

_COMMENT, _NAME, _RESOLUTION = 1, 2, 9
_END = struct.pack("<HH", 0, 0)
_BEFORE, _SIZES = struct.Struct("<III"), struct.Struct("<II")
_NANOSECONDS = b"\x09"
_LONGEST_OPTION = 65535


PacketPairEncoder: TypeAlias = Callable[[int, int, bytes], bytes]
"""Encodes the same data as two packets, and returns their pcapng blocks. Arguments: the times of both packets
in ns since 1970, and the data.
"""


class PcapngWriter:
    """Writes a capture packet by packet. An interface is described before its first packet."""

    def __init__(self, file: ByteSink) -> None:
        """Write the section header to `file`. If the file is buffered, the caller must flush it."""
        self._file = file
        self._interfaces: dict[Interface, int] = {}
        self.packet_count = 0
        write_all(file, _block(_SECTION_BLOCK, _SECTION))

    def write(self, packet: Packet) -> None:
        """Write a packet. Each comment is cut to 65,535 bytes. Raises OSError if the disk is full."""
        time, data, original, interface, comments = packet
        number = self._interfaces.get(interface)
        if number is None:
            number = self._write_interface(interface)
        options = b"".join([*(_option(_COMMENT, each) for each in comments), _END]) if comments else b""
        self.packet_count += 1
        captured = len(data)
        size = 32 + (captured + 3 & ~3) + len(options)
        head = _HEAD.pack(_PACKET_BLOCK, size, number, time >> 32 & _WORD, time & _WORD, captured, original)
        write_all(self._file, b"".join((head, data, _PADDING[captured & 3], options, _SIZE.pack(size))))

    def write_blocks(self, blocks: bytes, count: int) -> None:
        """Write `count` packets. Functions from `pair_encoder` encoded `blocks`. Raises OSError."""
        self.packet_count += count
        write_all(self._file, blocks)

    def pair_encoder(
        self, first: tuple[Interface, bytes], second: tuple[Interface, bytes], size: int
    ) -> PacketPairEncoder:
        """Return a function that encodes two packets with the same data at once. Encoding them one by one
        takes twice as long.

        `first` holds the interface and the headers of the first packet, and `second` those of the second
        packet. `size` is the number of bytes of data after the headers.

        Raises:
            OSError: The description of a new interface cannot be written.
        """
        before, between, end = self._constant_parts(*first, size)
        begin, also, behind = self._constant_parts(*second, size)
        joint = end + begin
        form = f"<{len(before)}sII{len(between)}s{size}s{len(joint)}sII{len(also)}s{size}s{len(behind)}s"
        pack = struct.Struct(form).pack

        def make(time: int, later: int, data: bytes) -> bytes:
            return pack(
                before,
                time >> 32 & _WORD,
                time & _WORD,
                between,
                data,
                joint,
                later >> 32 & _WORD,
                later & _WORD,
                also,
                data,
                behind,
            )

        return make

    def _constant_parts(self, interface: Interface, head: bytes, size: int) -> tuple[bytes, bytes, bytes]:
        """Return three parts of a packet block: before the packet's time, between time and data, after the
        data.
        """
        number = self._interfaces.get(interface)
        if number is None:
            number = self._write_interface(interface)
        captured = len(head) + size
        whole = 32 + (captured + 3 & ~3)
        before = _BEFORE.pack(_PACKET_BLOCK, whole, number)
        return before, _SIZES.pack(captured, captured) + head, _PADDING[captured & 3] + _SIZE.pack(whole)

    def _write_interface(self, interface: Interface) -> int:
        name = _option(_NAME, interface.name) if interface.name else b""
        resolution = struct.pack("<HH", _RESOLUTION, 1) + _padded(_NANOSECONDS)
        body = struct.pack("<HHI", interface.linktype, 0, 0) + name + resolution + _END
        write_all(self._file, _block(_INTERFACE_BLOCK, body))
        number = self._interfaces[interface] = len(self._interfaces)
        return number


def write_annotated(packets: Iterable[Packet], notes: Mapping[int, str], file: ByteSink) -> int:
    """Copy packets with the user's notes as comments; return the number of packets. May raise OSError.

    The key of `notes` is the packet number, from 1. An empty note only marks the packet.
    """
    writer = PcapngWriter(file)
    number = 0
    for number, packet in enumerate(packets, 1):
        note = notes.get(number)
        time, data, original, interface, comments = packet
        if note is not None:
            comments = (*comments, note or MARK_COMMENT)
        writer.write((time, data, original, interface, comments))
    return number


MARK_COMMENT = "marked"
"""Comment of a packet that the user marked without a note."""


def is_packet_block(block: bytes) -> bool:
    return block.startswith(_PACKET_BLOCK.to_bytes(4, "little"))


def _option(code: int, text: str) -> bytes:
    data = text.encode("utf-8", "replace")[:_LONGEST_OPTION]
    data = data.decode("utf-8", "ignore").encode()  # drop the last character if the limit cut it in two
    return struct.pack("<HH", code, len(data)) + _padded(data)


def _padded(data: bytes) -> bytes:
    return data + _PADDING[len(data) & 3]


def _block(kind: int, body: bytes) -> bytes:
    size = _SIZE.pack(12 + len(body))
    return _SIZE.pack(kind) + size + body + size
