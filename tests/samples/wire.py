"""Packets as a network card sees them, checksums included: IPv4 and IPv6, UDP and TCP."""

from __future__ import annotations

import struct
from ipaddress import ip_address
from typing import NamedTuple

TCP_FIN, TCP_SYN, TCP_RST, TCP_PSH, TCP_ACK = 0x01, 0x02, 0x04, 0x08, 0x10

_UDP, _TCP = 17, 6
_ETHERTYPES = {4: 0x0800, 6: 0x86DD}
_VLAN = 0x8100
_SERVICE_VLAN = 0x88A8
_ARPHRD_ETHER = 1


class Host(NamedTuple):
    """One end of a conversation.

    Attributes:
        mac: six bytes.
        ip: IPv4 or IPv6 address as text.
        port: UDP or TCP port.
    """

    mac: bytes
    ip: str
    port: int


def udp(src: Host, dst: Host, payload: bytes, ident: int = 0) -> bytes:
    """Return the IP packet of one datagram."""
    head = struct.pack(">HHHH", src.port, dst.port, 8 + len(payload), 0)
    return _ip(src, dst, _UDP, head, payload, ident=ident)


def tcp(
    src: Host, dst: Host, *, seq: int, ack: int, flags: int, payload: bytes = b"", ident: int = 0
) -> bytes:
    """Return the IP packet of one segment; sequence numbers wrap."""
    numbers = (seq & 0xFFFFFFFF, ack & 0xFFFFFFFF)
    head = struct.pack(">HHIIBBHHH", src.port, dst.port, *numbers, 0x50, flags, 0xFAF0, 0, 0)
    return _ip(src, dst, _TCP, head, payload, ident=ident)


def ethernet(src: Host, dst: Host, packet: bytes, vlans: tuple[int, ...] = ()) -> bytes:
    """Put an Ethernet header before an IP packet; of two VLAN ids the first is the provider's."""
    tags = b""
    for depth, vlan in enumerate(vlans):
        outer = len(vlans) > 1 and depth == 0
        tags += struct.pack(">HH", _SERVICE_VLAN if outer else _VLAN, vlan)
    return dst.mac + src.mac + tags + _ETHERTYPES[packet[0] >> 4].to_bytes(2, "big") + packet


def cooked(src: Host, packet: bytes, outgoing: bool, interface: int) -> bytes:
    """Put the header of "Linux cooked v2" before an IP packet, as ``tcpdump -i any`` does."""
    kind = _ETHERTYPES[packet[0] >> 4]
    packet_type = 4 if outgoing else 0
    return struct.pack(">HHIHBB8s", kind, 0, interface, _ARPHRD_ETHER, packet_type, 6, src.mac) + packet


def _ip(src: Host, dst: Host, kind: int, head: bytes, payload: bytes, *, ident: int) -> bytes:
    """Fill the checksum into the UDP or TCP header `head` and put the IP header before it."""
    checksum_at = 6 if kind == _UDP else 16
    ends = ip_address(src.ip).packed + ip_address(dst.ip).packed
    size = len(head) + len(payload)
    checksum = _checksum(ends + struct.pack(">II", size, kind) + head + payload)
    if kind == _UDP:
        checksum = checksum or 0xFFFF
    segment = head[:checksum_at] + checksum.to_bytes(2, "big") + head[checksum_at + 2 :] + payload
    if len(ends) == 32:
        return struct.pack(">IHBB", 6 << 28, size, kind, 64) + ends + segment
    ip_head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + size, ident, 0x4000, 64, kind, 0) + ends
    return ip_head[:10] + _checksum(ip_head).to_bytes(2, "big") + ip_head[12:] + segment


def _checksum(data: bytes) -> int:
    """Internet checksum (RFC 1071)."""
    data += bytes(len(data) % 2)
    total: int = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
