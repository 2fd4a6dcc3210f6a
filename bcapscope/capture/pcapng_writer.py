"""Writing packets as pcapng (draft-ietf-opsawg-pcapng), with the notes that people made on them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from io import RawIOBase
from typing import BinaryIO, NamedTuple, TypeAlias

from bcapscope.capture.append_log import write_all
from bcapscope.capture.packet import Interface, Packet

_SECTION_BLOCK, _INTERFACE_BLOCK, _PACKET_BLOCK = 0x0A0D0D0A, 1, 6
_SECTION = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
_HEAD, _SIZE = struct.Struct("<IIIIIII"), struct.Struct("<I")
_WORD = 0xFFFFFFFF
_PADDING = b"", b"\0\0\0", b"\0\0", b"\0"
"""By the two low bits of what is to be padded to four bytes."""

_COMMENT, _NAME, _RESOLUTION = 1, 2, 9
_END = struct.pack("<HH", 0, 0)
_BEFORE, _SIZES = struct.Struct("<III"), struct.Struct("<II")
_NANOSECONDS = b"\x09"
_LONGEST_OPTION = 65535


class PacketTemplate(NamedTuple):
    """What the blocks of packets have in common that differ in their times and in their last bytes alone.

    Attributes:
        before_time: what stands before the time.
        after_time: what stands between the time and those bytes.
        after_data: what stands behind them.
        data_size: how many bytes they are.
    """

    before_time: bytes
    after_time: bytes
    after_data: bytes
    data_size: int


PacketPairEncoder: TypeAlias = Callable[[int, int, bytes], bytes]
"""Makes the blocks of two packets that end alike; takes their times, ns since 1970, and those bytes."""


class PcapngWriter:
    """A capture that is being written, a packet at a time; each interface is described before its first."""

    def __init__(self, file: BinaryIO | RawIOBase) -> None:
        """Write the head of the capture to `file`, which is not buffered or flushed by the caller."""
        self._file = file
        self._interfaces: dict[Interface, int] = {}
        write_all(file, _block(_SECTION_BLOCK, _SECTION))

    def write(self, packet: Packet) -> None:
        """Write a packet; times are kept to the nanosecond, of comments what fits an option.

        Raises:
            OSError: there is no room.
        """
        time, data, original, interface, comments = packet
        number = self._interfaces.get(interface)
        if number is None:
            number = self._write_interface(interface)
        options = b"".join([*(_option(_COMMENT, each) for each in comments), _END]) if comments else b""
        captured = len(data)
        size = 32 + (captured + 3 & ~3) + len(options)
        head = _HEAD.pack(_PACKET_BLOCK, size, number, time >> 32 & _WORD, time & _WORD, captured, original)
        write_all(self._file, b"".join((head, data, _PADDING[captured & 3], options, _SIZE.pack(size))))

    def write_blocks(self, blocks: bytes) -> None:
        """Write packets whose blocks were made with moulds of this writer.

        Raises:
            OSError: there is no room.
        """
        write_all(self._file, blocks)

    def packet_template(self, interface: Interface, head: bytes, size: int) -> PacketTemplate:
        """Make the mould of packets without comments that begin with `head` and end with so many bytes.

        Raises:
            OSError: there is no room for the description of the interface.
        """
        number = self._interfaces.get(interface)
        if number is None:
            number = self._write_interface(interface)
        captured = len(head) + size
        whole = 32 + (captured + 3 & ~3)
        before = _BEFORE.pack(_PACKET_BLOCK, whole, number)
        return PacketTemplate(
            before, _SIZES.pack(captured, captured) + head, _PADDING[captured & 3] + _SIZE.pack(whole), size
        )

    def _write_interface(self, interface: Interface) -> int:
        name = _option(_NAME, interface.name) if interface.name else b""
        resolution = struct.pack("<HH", _RESOLUTION, 1) + _padded(_NANOSECONDS)
        body = struct.pack("<HHI", interface.linktype, 0, 0) + name + resolution + _END
        write_all(self._file, _block(_INTERFACE_BLOCK, body))
        number = self._interfaces[interface] = len(self._interfaces)
        return number


def pair_encoder(first: PacketTemplate, second: PacketTemplate) -> PacketPairEncoder:
    """Return what makes the blocks of a packet of each mould at once, which takes half as long.

    Both moulds are for so many last bytes alike.
    """
    joint = first.after_data + second.before_time
    before, between, also, behind = first.before_time, first.after_time, second.after_time, second.after_data
    size = first.data_size
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


def write_annotated(packets: Iterable[Packet], notes: Mapping[int, str], file: BinaryIO | RawIOBase) -> int:
    """Write packets anew, with notes beside the comments that they have already.

    Args:
        packets: of any capture.
        notes: by number of the packet, from 1; an empty one only marks it.
        file: where to write.

    Returns:
        How many packets were written.

    Raises:
        CaptureError: as reading `packets` does.
        OSError: there is no room.
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
"""The comment of a packet that was marked without a note."""


def is_packet_block(block: bytes) -> bool:
    """Tell whether a block that was written is a packet, and not the description of something."""
    return block.startswith(_PACKET_BLOCK.to_bytes(4, "little"))


def _option(code: int, text: str) -> bytes:
    data = text.encode("utf-8", "replace")[:_LONGEST_OPTION]
    data = data.decode("utf-8", "ignore").encode()  # no character cut in two
    return struct.pack("<HH", code, len(data)) + _padded(data)


def _padded(data: bytes) -> bytes:
    return data + _PADDING[len(data) & 3]


def _block(kind: int, body: bytes) -> bytes:
    size = _SIZE.pack(12 + len(body))
    return _SIZE.pack(kind) + size + body + size
