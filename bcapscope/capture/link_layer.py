"""Find and parse the IP packet in a captured packet: link headers, IPv4, IPv6.

Sources for the link headers: IEEE 802.3 and 802.1Q for Ethernet; RFC 1042 for LLC and SNAP; RFC 1661 and 1662
for PPP, RFC 1332 and 5072 for its protocol numbers, RFC 2516 for PPP over Ethernet; the LINKTYPE_ documents
of tcpdump.org for all others. Sources for IP: RFC 791 (IPv4) and RFC 8200 (IPv6).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

ETHERNET, LINUX_COOKED, LINUX_COOKED_2 = 1, 113, 276

_IPV4, _IPV6 = 0x0800, 0x86DD
_VLAN_TAGS = frozenset({0x8100, 0x88A8, 0x9100})
"""Ethernet types of VLAN tags: customer and service tag (IEEE 802.1Q), and an older service tag."""

_MAX_LENGTH_FIELD = 1500
"""Up to this value, Ethernet's type field is a length, and an LLC header follows (IEEE 802.3)."""

_SNAP = b"\xaa\xaa\x03\x00\x00\x00"
"""LLC header that announces SNAP, followed by SNAP's organisation code for Ethernet types."""

_PPPOE, _PPPOE_SIZE = 0x8864, 6
_PPP_FRAMING = b"\xff\x03"
_PPP_IP = frozenset({0x0021, 0x0057})

_LOOPBACK_FAMILIES = frozenset({2, 10, 24, 28, 30})
"""AF_INET (2), and AF_INET6 on Linux (10), NetBSD and OpenBSD (24), FreeBSD (28) and macOS (30)."""

_HOP_BY_HOP, _ROUTING, _FRAGMENT, _AUTHENTICATION, _DESTINATION = 0, 43, 44, 51, 60
_EXTENSIONS = frozenset({_HOP_BY_HOP, _ROUTING, _AUTHENTICATION, _DESTINATION, 135, 139, 140})
_NO_NEXT_HEADER = 59

NOT_IP = -1

_IPV4_HEADER = struct.Struct(">2xH2sHxBxx8s")


class Fragment(NamedTuple):
    """Position of an IP fragment in bytes. `key` holds addresses, identification and, in IPv4, protocol."""

    key: bytes
    offset: int
    more: bool


class IPPacket(NamedTuple):
    """Payload and header fields of an IP packet. `addresses` holds source and destination, 4 or 16 bytes
    each.

    Attributes:
        protocol: Number of the transport protocol, 17 for UDP, 6 for TCP.
        payload: Captured payload of the IP packet, without padding of the link.
        missing: Number of bytes at the end of the payload that the capture lacks.
        fragment: None for a whole packet.
    """

    protocol: int
    addresses: bytes
    payload: bytes
    missing: int
    fragment: Fragment | None


def find_ip(linktype: int, data: bytes) -> int:
    """Return the offset of the IP header, or `NOT_IP`. Raises KeyError for an unknown link type."""
    offset = IP_OFFSET_FINDERS[linktype](data)
    return offset if offset < len(data) else NOT_IP


def read_ip(data: bytes, offset: int) -> IPPacket | None:
    """Parse the IP packet at `offset`; return None if the IP header is invalid."""
    version = data[offset] >> 4
    if version == 4:
        return _read_ipv4(data, offset)
    return _read_ipv6(data, offset) if version == 6 else None


def _ip_in_payload(data: bytes, kind: int, offset: int) -> int:
    """Find the IP header in a payload of the Ethernet type `kind`, after VLAN tags, SNAP and PPPoE."""
    while kind in _VLAN_TAGS:
        kind = int.from_bytes(data[offset + 2 : offset + 4])
        offset += 4
    if kind <= _MAX_LENGTH_FIELD:
        if not data.startswith(_SNAP, offset):
            return NOT_IP
        offset += len(_SNAP)
        kind = int.from_bytes(data[offset : offset + 2])
        offset += 2
    if kind == _PPPOE:
        return _ip_after_ppp(data, offset + _PPPOE_SIZE)
    return offset if kind in (_IPV4, _IPV6) else NOT_IP


def _ip_after_ppp(data: bytes, offset: int) -> int:
    """Skip the PPP protocol field, which has two bytes, or one byte if both ends agreed to compress it."""
    compressed = data[offset : offset + 1]
    if compressed and compressed[0] & 1:
        return offset + 1 if compressed[0] in _PPP_IP else NOT_IP
    return offset + 2 if int.from_bytes(data[offset : offset + 2]) in _PPP_IP else NOT_IP


def _ppp(data: bytes) -> int:
    return _ip_after_ppp(data, len(_PPP_FRAMING) if data.startswith(_PPP_FRAMING) else 0)


def _loopback(data: bytes) -> int:
    """Skip the address family. The address family is big-endian for LINKTYPE_LOOP. Otherwise, it has the byte
    order of the capturing machine.
    """
    families = {int.from_bytes(data[:4], "little"), int.from_bytes(data[:4])}
    return 4 if families & _LOOPBACK_FAMILIES else NOT_IP


def _raw(_: bytes) -> int:
    return 0


IP_OFFSET_FINDERS: dict[int, Callable[[bytes], int]] = {
    0: _loopback,
    ETHERNET: lambda data: _ip_in_payload(data, int.from_bytes(data[12:14]), 14),
    9: _ppp,
    12: _raw,
    14: _raw,
    50: _ppp,
    101: _raw,
    108: _loopback,
    LINUX_COOKED: lambda data: _ip_in_payload(data, int.from_bytes(data[14:16]), 16),
    228: _raw,
    229: _raw,
    LINUX_COOKED_2: lambda data: _ip_in_payload(data, int.from_bytes(data[:2]), 20),
}
"""For each link type, the function that returns the offset of the IP header."""


def _read_ipv4(data: bytes, offset: int) -> IPPacket | None:
    size = (data[offset] & 15) * 4
    start = offset + size
    if size < 20 or start > len(data):
        return None
    total, identification, part, protocol, addresses = _IPV4_HEADER.unpack_from(data, offset)
    # The length field is 0 in a sent packet if the sender's network card fills in the field later.
    total = total or len(data) - offset
    if total < size:
        return None
    payload = data[start : offset + total]
    fragment = None
    if part & 0x3FFF:
        key = addresses + identification + bytes((protocol,))
        fragment = Fragment(key, (part & 0x1FFF) * 8, bool(part & 0x2000))
    return IPPacket(protocol, addresses, payload, total - size - len(payload), fragment)


def _read_ipv6(data: bytes, offset: int) -> IPPacket | None:
    start = offset + 40
    if start > len(data):
        return None
    # The length field is 0 in a jumbogram (RFC 2675), or if the network card fills in the field later.
    length = int.from_bytes(data[offset + 4 : offset + 6]) or len(data) - start
    stop = start + length
    protocol, addresses = data[offset + 6], data[offset + 8 : start]
    fragment = None
    while protocol in _EXTENSIONS or protocol == _FRAGMENT:
        if start + 8 > min(stop, len(data)):
            return None
        following, words = data[start], data[start + 1]
        if protocol == _FRAGMENT:
            place = int.from_bytes(data[start + 2 : start + 4])
            if place & 0xFFF9:  # offset and flag are 0 if the packet is not fragmented (RFC 6946)
                fragment = Fragment(addresses + data[start + 4 : start + 8], place & 0xFFF8, bool(place & 1))
            start += 8
        else:
            start += (words + 2) * 4 if protocol == _AUTHENTICATION else (words + 1) * 8
        protocol = following
        if fragment is not None:
            break
    if start > stop or protocol == _NO_NEXT_HEADER:
        return None
    payload = data[start:stop]
    return IPPacket(protocol, addresses, payload, stop - start - len(payload), fragment)
