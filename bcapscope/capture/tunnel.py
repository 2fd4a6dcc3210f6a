"""Unpack tunnels, in which switches and capture probes send mirrored traffic.

IP in IP (RFC 2003, RFC 2473, RFC 4213), GRE (RFC 2784, RFC 2890), VXLAN (RFC 7348). GRE can also carry
Ethernet frames and ERSPAN of types I, II and III (draft-foschiano-erspan-03).
"""

from __future__ import annotations

from bcapscope.capture.link_layer import ETHERNET, NOT_IP, IPPacket, find_ip, read_ip

DEEPEST_TUNNEL = 8
"""Maximum number of nested tunnels. A hostile packet could have thousands of tunnels."""

_IPV4_IN_IP, _UDP, _IPV6_IN_IP, _GRE = 4, 17, 41, 47

_GRE_CHECKSUM, _GRE_ROUTING, _GRE_KEY, _GRE_SEQUENCE, _GRE_VERSION = 0x8000, 0x4000, 0x2000, 0x1000, 7
_IP_TYPES = frozenset({0x0800, 0x86DD})
_BRIDGED_ETHERNET, _ERSPAN, _ERSPAN_3 = 0x6558, 0x88BE, 0x22EB
_ERSPAN_2_SIZE, _ERSPAN_3_SIZE, _ERSPAN_PLATFORM_SIZE = 8, 12, 8
_ERSPAN_3_IP = 2

_VXLAN_PORTS = frozenset({4789, 8472})  # IANA assigned 4789; 8472 is the older default of Linux

_VXLAN_FLAG = 0x08
"""Flag in the first byte: the network identifier is valid. Extensions of VXLAN define the other flags."""

_UDP_HEADER_SIZE, _VXLAN_SIZE = 8, 8


def packet_in_tunnel(packet: IPPacket) -> IPPacket | None:
    """Return the IP packet inside `packet`, which must not be a fragment; None if `packet` is no tunnel."""
    payload = packet.payload
    if packet.protocol == _UDP:
        return _in_vxlan(payload)
    if packet.protocol == _GRE:
        return _in_gre(payload)
    return _ip_at(payload, 0) if packet.protocol in (_IPV4_IN_IP, _IPV6_IN_IP) else None


def _in_vxlan(payload: bytes) -> IPPacket | None:
    if int.from_bytes(payload[2:4]) not in _VXLAN_PORTS:
        return None
    header = payload[_UDP_HEADER_SIZE : _UDP_HEADER_SIZE + _VXLAN_SIZE]
    if not header or not header[0] & _VXLAN_FLAG:
        return None
    return _in_ethernet(payload[_UDP_HEADER_SIZE + _VXLAN_SIZE :])


def _in_gre(payload: bytes) -> IPPacket | None:
    flags, kind = int.from_bytes(payload[:2]), int.from_bytes(payload[2:4])
    if flags & (_GRE_ROUTING | _GRE_VERSION):
        return None
    offset = 4 + 4 * sum(bool(flags & flag) for flag in (_GRE_CHECKSUM, _GRE_KEY, _GRE_SEQUENCE))
    if kind in _IP_TYPES:
        return _ip_at(payload, offset)
    # ERSPAN type I has neither a sequence number nor an ERSPAN header
    if kind == _ERSPAN and flags & _GRE_SEQUENCE:
        offset += _ERSPAN_2_SIZE
    elif kind == _ERSPAN_3:
        last = int.from_bytes(payload[offset + 10 : offset + 12])  # last bit: a further header follows
        offset += _ERSPAN_3_SIZE + (_ERSPAN_PLATFORM_SIZE if last & 1 else 0)
        if last >> 10 & 0x1F == _ERSPAN_3_IP:
            return _ip_at(payload, offset)
    elif kind not in (_BRIDGED_ETHERNET, _ERSPAN):
        return None
    return _in_ethernet(payload[offset:])


def _in_ethernet(frame: bytes) -> IPPacket | None:
    offset = find_ip(ETHERNET, frame)
    return None if offset == NOT_IP else read_ip(frame, offset)


def _ip_at(payload: bytes, offset: int) -> IPPacket | None:
    return read_ip(payload, offset) if offset < len(payload) else None
