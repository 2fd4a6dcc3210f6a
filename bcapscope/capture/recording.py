"""Writing what passes a socket as a capture: raw IP packets in pcapng, which other tools read as well.

A socket shows neither IP nor transport headers; they are made up around the bytes, with the real addresses
and ports. TCP segments are those that the socket took or gave, without handshake and acknowledgements.
Format: draft-ietf-opsawg-pcapng; link type RAW (101), times in nanoseconds.
"""

from __future__ import annotations

import ipaddress
import struct
from io import RawIOBase
from typing import BinaryIO

Address = tuple[str, int]
"""IP address as text, and port."""

_RAW, _SNAP_LENGTH = 101, 0
_UDP, _TCP = 17, 6
_PUSH_ACK = 0x18
_SECTION = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
_NANOSECONDS = struct.pack("<HHB3x", 9, 1, 9) + struct.pack("<HH", 0, 0)
_MOST_BYTES = 60_000
"""Of a TCP segment; longer ones become several packets."""


class Recording:
    """A capture that is being written, a packet at a time."""

    def __init__(self, file: BinaryIO | RawIOBase) -> None:
        """Write the head of the capture to `file`, which is not buffered or flushed by the caller."""
        self._file = file
        self._sequence: dict[tuple[Address, Address], int] = {}
        interface = struct.pack("<HHI", _RAW, 0, _SNAP_LENGTH) + _NANOSECONDS
        file.write(_block(0x0A0D0D0A, _SECTION) + _block(1, interface))

    def datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Write a UDP datagram; `time` is ns since 1970."""
        header = struct.pack(">HHHH", source[1], target[1], 8 + len(data), 0)
        self._write(_packet(source, target, _UDP, header + data), time)

    def segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Write bytes of a TCP connection; `time` is ns since 1970."""
        for start in range(0, len(data), _MOST_BYTES):
            piece = data[start : start + _MOST_BYTES]
            sent = self._sequence.get((source, target), 1)
            heard = self._sequence.get((target, source), 1)
            self._sequence[source, target] = (sent + len(piece)) & 0xFFFFFFFF
            flags = 5 << 12 | _PUSH_ACK
            header = struct.pack(">HHIIHHHH", source[1], target[1], sent, heard, flags, 65535, 0, 0)
            self._write(_packet(source, target, _TCP, header + piece), time)

    def ended(self, client: Address, server: Address) -> None:
        """Forget a connection that is gone."""
        self._sequence.pop((client, server), None)
        self._sequence.pop((server, client), None)

    def _write(self, packet: bytes, time: int) -> None:
        head = struct.pack("<IIIII", 0, time >> 32, time & 0xFFFFFFFF, len(packet), len(packet))
        self._file.write(_block(6, head + packet.ljust(len(packet) + 3 & ~3, b"\0")))


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", 12 + len(body))
    return struct.pack("<I", kind) + size + body + size


def _packet(source: Address, target: Address, protocol: int, payload: bytes) -> bytes:
    """Put an IP header before `payload`; IPv6 where one of the addresses is."""
    ends = [ipaddress.ip_address(address.partition("%")[0]) for address, _ in (source, target)]
    if any(end.version == 6 for end in ends):
        head = struct.pack(">IHBB", 6 << 28, len(payload), protocol, 64)
    else:
        head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(payload), 0, 0x4000, 64, protocol, 0)
    whole = head + b"".join(end.packed for end in ends)
    if len(head) == 12:
        whole = whole[:10] + _checksum(whole).to_bytes(2, "big") + whole[12:]
    return whole + payload


def _checksum(header: bytes) -> int:
    """Return the checksum of an IPv4 header whose own is 0 (RFC 791)."""
    total: int = sum(struct.unpack(f">{len(header) // 2}H", header))
    total = (total & 0xFFFF) + (total >> 16)
    return ~(total + (total >> 16)) & 0xFFFF
