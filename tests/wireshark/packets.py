"""Captures that hold given bytes, over UDP and TCP, as raw IPv4."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from ipaddress import IPv4Address
from pathlib import Path

CLIENT, CONTROLLER = IPv4Address("10.0.0.2").packed, IPv4Address("10.0.0.1").packed
PORT = 5007
_SYN, _PSH, _ACK = 2, 8, 16


def _ip(protocol: int, to_controller: bool, segment: bytes) -> bytes:
    ends = CLIENT + CONTROLLER if to_controller else CONTROLLER + CLIENT
    return struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), 0, 0, 64, protocol, 0) + ends + segment


def _ports(to_controller: bool, client: int, controller: int) -> bytes:
    return struct.pack(">HH", *((client, controller) if to_controller else (controller, client)))


def udp_packet(to_controller: bool, data: bytes, controller: int = PORT) -> bytes:
    """Return a UDP packet without checksums."""
    return _ip(
        17,
        to_controller,
        _ports(to_controller, 50001, controller) + struct.pack(">HH", 8 + len(data), 0) + data,
    )


def _tcp_packet(to_controller: bool, ports: bytes, seq: int, flags: int, data: bytes = b"") -> bytes:
    head = ports + struct.pack(">IIBBHHH", seq, 0 if flags == _SYN else 1, 0x50, flags, 65535, 0, 0)
    return _ip(6, to_controller, head + data)


def tcp_packets(
    to_controller: bool, segments: Sequence[bytes], client: int, controller: int = PORT
) -> list[bytes]:
    """Return the packets of a connection with its handshake, in which one end sends `segments`."""
    packets = [
        _tcp_packet(True, _ports(True, client, controller), 0, _SYN),
        _tcp_packet(False, _ports(False, client, controller), 0, _SYN | _ACK),
    ]
    ports, seq = _ports(to_controller, client, controller), 1
    for data in filter(None, segments):
        packets.append(_tcp_packet(to_controller, ports, seq, _PSH | _ACK, data))
        seq += len(data)
    return packets


def write_capture(path: Path, packets: Iterable[bytes], kept: int = 262144) -> Path:
    """Write packets to a pcap file, one per millisecond; of each packet, the first `kept` bytes."""
    records = [
        struct.pack("<IIII", 1_700_000_000 + index // 1000, index % 1000 * 1000, len(data[:kept]), len(data))
        + data[:kept]
        for index, data in enumerate(packets)
    ]
    path.write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262144, 101) + b"".join(records))
    return path
