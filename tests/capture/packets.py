"""Packets and capture files made by hand, byte by byte, for the tests of reading them."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant

CLIENT, SERVER = bytes((10, 0, 0, 2)), bytes((10, 0, 0, 1))
CLIENT_PORT, SERVER_PORT = 50001, 5007
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def request(serial: int, function_id: int = 22, handle: int = 1) -> bytes:
    """A call of a function that takes a handle only; by default Controller_GetTag."""
    return encode_frame(serial, 0, function_id, [Variant(VT.I4, handle)])


def reply(serial: int, hresult: int = 0, value: int = 7) -> bytes:
    """A result with one number."""
    return encode_frame(serial, 0, hresult, [Variant(VT.I4, value)])


def service_start(serial: int = 1) -> bytes:
    """The first call of every session."""
    return encode_frame(serial, 0, 1, [Variant(VT.BSTR, "")])


def udp(payload: bytes, sport: int = CLIENT_PORT, dport: int = SERVER_PORT, size: int | None = None) -> bytes:
    """A UDP datagram with its header."""
    return struct.pack(">HHHH", sport, dport, 8 + len(payload) if size is None else size, 0) + payload


def tcp(
    payload: bytes = b"",
    *,
    seq: int = 0,
    ack: int | None = None,
    flags: int = 0,
    sport: int = CLIENT_PORT,
    dport: int = SERVER_PORT,
    options: bytes = b"",
) -> bytes:
    """A TCP segment with its header; an acknowledgement sets its flag."""
    flags |= 16 if ack is not None else 0
    offset = (5 + len(options) // 4) << 4
    head = struct.pack(">HHIIBB", sport, dport, seq % 2**32, (ack or 0) % 2**32, offset, flags)
    return head + struct.pack(">HHH", 65535, 0, 0) + options + payload


def ipv4(
    content: bytes,
    source: bytes = CLIENT,
    destination: bytes = SERVER,
    *,
    protocol: int = 17,
    options: bytes = b"",
    identification: int = 1,
    part: int = 0x4000,
    total: int | None = None,
) -> bytes:
    """An IPv4 packet; `part` is the word of flags and fragment offset."""
    size = 20 + len(options)
    total = size + len(content) if total is None else total
    head = struct.pack(">BBHHHBBH", 0x40 | size // 4, 0, total, identification, part, 64, protocol, 0)
    return head + source + destination + options + content


def ipv6(
    content: bytes,
    source: bytes = bytes(15) + b"\x02",
    destination: bytes = bytes(15) + b"\x01",
    following: int = 17,
    length: int | None = None,
) -> bytes:
    """An IPv6 packet."""
    length = len(content) if length is None else length
    return struct.pack(">IHBB", 6 << 28, length, following, 64) + source + destination + content


def ethernet(content: bytes, kind: int = 0x0800, tags: Iterable[int] = ()) -> bytes:
    """An Ethernet frame, padded as the wire has it, with VLAN tags of the given types."""
    types = b"".join(struct.pack(">HH", tag, 5) for tag in tags)
    return (bytes(12) + types + struct.pack(">H", kind) + content).ljust(60, b"\xee")


def from_client(payload: bytes, port: int = SERVER_PORT) -> bytes:
    """A datagram to the server, on Ethernet."""
    return ethernet(ipv4(udp(payload, CLIENT_PORT, port)))


def from_server(payload: bytes, port: int = SERVER_PORT) -> bytes:
    """A datagram to the client, on Ethernet."""
    return ethernet(ipv4(udp(payload, port, CLIENT_PORT), SERVER, CLIENT))


def pcap_header(linktype: int = 1, order: str = "<", magic: int = 0xA1B2C3D4) -> bytes:
    """The beginning of a classic capture file."""
    return struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, linktype)


def pcap_record(
    data: bytes,
    seconds: int = 1_700_000_000,
    fraction: int = 0,
    order: str = "<",
    original: int | None = None,
) -> bytes:
    """One packet of a classic capture file."""
    return struct.pack(order + "IIII", seconds, fraction, len(data), original or len(data)) + data


def pcap(*packets: bytes, linktype: int = 1) -> bytes:
    """A classic capture file, a packet each second."""
    records = (pcap_record(data, 1_700_000_000 + index) for index, data in enumerate(packets))
    return pcap_header(linktype) + b"".join(records)


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """A block of a pcapng file."""
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", 12 + len(body))
    return struct.pack(order + "I", kind) + size + body + size


def option(code: int, value: bytes, order: str = "<") -> bytes:
    """An option of a pcapng block."""
    return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)


END_OF_OPTIONS = bytes(4)


def section(order: str = "<", version: int = 1) -> bytes:
    """A section header block."""
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, version, 0, -1), order)


def interface(linktype: int = 1, options: bytes = b"", snaplen: int = 0, order: str = "<") -> bytes:
    """An interface description block."""
    return block(1, struct.pack(order + "HHI", linktype, 0, snaplen) + options, order)


def enhanced(
    data: bytes,
    ticks: int = 0,
    *,
    number: int = 0,
    options: bytes = b"",
    order: str = "<",
    kept: int | None = None,
    original: int | None = None,
) -> bytes:
    """An enhanced packet block."""
    kept = len(data) if kept is None else kept
    head = struct.pack(order + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, kept, original or len(data))
    return block(6, head + data + bytes(-len(data) % 4) + options, order)


def simple(data: bytes, order: str = "<", original: int | None = None) -> bytes:
    """A simple packet block."""
    return block(3, struct.pack(order + "I", original or len(data)) + data, order)


def obsolete(data: bytes, ticks: int = 0, order: str = "<", options: bytes = b"") -> bytes:
    """An obsolete packet block, of interface 0."""
    high, low = ticks >> 32, ticks & 0xFFFFFFFF
    head = struct.pack(order + "HHIIII", 0, 0xFFFF, high, low, len(data), len(data))
    return block(2, head + data + bytes(-len(data) % 4) + options, order)
