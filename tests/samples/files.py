"""Capture files from packets: pcap and pcapng, in the forms that capture programs write."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

ETHERNET = 1
LINUX_COOKED_2 = 276

_SNAP_LENGTH = 262144
_COMMENT, _IF_NAME, _IF_DESCRIPTION, _IF_TSRESOL, _SHB_USERAPPL = 1, 2, 3, 9, 4
_NANOSECONDS = b"\x09"


class Packet(NamedTuple):
    """A captured packet.

    Attributes:
        time: nanoseconds since 1970.
        data: from the link layer on.
        comment: what a person wrote beside it; pcapng only.
        interface: index into the file's interfaces; pcapng only.
        length: bytes that it had on the wire where the capture kept fewer; 0 for all of them.
    """

    time: int
    data: bytes
    comment: str = ""
    interface: int = 0
    length: int = 0


class Interface(NamedTuple):
    """A network interface of a pcapng file.

    Attributes:
        name: as the system calls it.
        description: in words.
        link: link-layer type.
        nanoseconds: resolution of its time stamps; else microseconds.
    """

    name: str
    description: str = ""
    link: int = ETHERNET
    nanoseconds: bool = True


def pcap(
    packets: Iterable[Packet], link: int = ETHERNET, nanoseconds: bool = False, big_endian: bool = False
) -> bytes:
    """Return a pcap file."""
    order = ">" if big_endian else "<"
    magic, unit = (0xA1B23C4D, 1) if nanoseconds else (0xA1B2C3D4, 1000)
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, _SNAP_LENGTH, link)]
    for packet in packets:
        seconds, nanos = divmod(packet.time, 1_000_000_000)
        size = len(packet.data)
        parts.append(struct.pack(order + "IIII", seconds, nanos // unit, size, packet.length or size))
        parts.append(packet.data)
    return b"".join(parts)


def pcapng(packets: Iterable[Packet], interfaces: Sequence[Interface], comment: str = "") -> bytes:
    """Return a pcapng file of one little-endian section."""
    header = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
    parts = [_block(0x0A0D0D0A, header + _options((_COMMENT, comment), (_SHB_USERAPPL, "tests.samples")))]
    for interface in interfaces:
        resolution = _NANOSECONDS if interface.nanoseconds else b""
        options = _options(
            (_IF_NAME, interface.name), (_IF_DESCRIPTION, interface.description), (_IF_TSRESOL, resolution)
        )
        parts.append(_block(1, struct.pack("<HHI", interface.link, 0, _SNAP_LENGTH) + options))
    for packet in packets:
        unit = 1 if interfaces[packet.interface].nanoseconds else 1000
        stamp = packet.time // unit
        size = len(packet.data)
        head = struct.pack(
            "<IIIII", packet.interface, stamp >> 32, stamp & 0xFFFFFFFF, size, packet.length or size
        )
        parts.append(_block(6, head + _padded(packet.data) + _options((_COMMENT, packet.comment))))
    return b"".join(parts)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", 12 + len(body))
    return struct.pack("<I", kind) + size + body + size


def _options(*options: tuple[int, str | bytes]) -> bytes:
    """Encode the options that have a value; nothing at all where none has."""
    parts = []
    for code, value in options:
        data = value.encode() if isinstance(value, str) else value
        if data:
            parts.append(struct.pack("<HH", code, len(data)) + _padded(data))
    return b"".join(parts) + bytes(4) if parts else b""


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
