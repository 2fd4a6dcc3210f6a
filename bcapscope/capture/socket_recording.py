"""Record the traffic of sockets as a capture: raw IP packets in pcapng, which other tools can read.

A socket shows no headers, so the headers are artificial. Addresses and ports are real. Each TCP segment holds
the bytes of one send or receive. Acknowledgements are not recorded.
"""

from __future__ import annotations

import ipaddress
import struct
from functools import lru_cache

from bcapscope.capture.append_log import ByteSink
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.pcapng_writer import PacketPairEncoder, PcapngWriter

Address = tuple[str, int]
"""IP address as text, and port."""

Hop = tuple[Address, Address, Interface]
"""Source address, target address and interface of a datagram."""

RAW_IP = 101
"""LINKTYPE_RAW, the link type of packets that begin with the IP header."""

_UNNAMED_INTERFACE = Interface(RAW_IP)
_UDP, _TCP = 17, 6
_FIN, _SYN, _RST, _PUSH, _ACK = 1, 2, 4, 8, 16
_MAX_SEGMENT_BYTES = 60_000
"""Maximum number of bytes in a recorded TCP segment. Longer data becomes several packets."""

_SEQUENCE_NS = 4000
"""Time in ns in which the initial sequence number grows by one, as in RFC 9293, 3.4.1."""

_MAX_HEADERS = 4096
"""Maximum number of cached datagram headers, and of cached pairs of addresses."""

_IPV4 = struct.Struct(">BBHHHBBH8s")
_IPV6 = struct.Struct(">IHBB32s")
_DATAGRAM = struct.Struct(">HHHH")
_SEGMENT = struct.Struct(">HHIIHHHH")


class SocketRecording:
    """Writes the data that sockets send and receive to a capture. Times are in ns since 1970."""

    def __init__(self, file: ByteSink) -> None:
        """Write the header of the capture to `file`. If `file` is buffered, the caller must flush it."""
        self._sequence: dict[tuple[Address, Address], int] = {}
        self._writer = PcapngWriter(file)

    @property
    def packet_count(self) -> int:
        return self._writer.packet_count

    def continue_in(self, file: ByteSink) -> None:
        """Write all further packets to another file, which readers can open without the previous file."""
        self._writer = PcapngWriter(file)

    def write_packet(self, packet: Packet) -> None:
        self._writer.write(packet)

    def write_datagram(
        self,
        source: Address,
        target: Address,
        data: bytes,
        time: int,
        *,
        interface: Interface = _UNNAMED_INTERFACE,
        comment: str = "",
    ) -> None:
        packet = _datagram_header(source, target, len(data)) + data
        self._writer.write((time, packet, len(packet), interface, (comment,) if comment else ()))

    def datagram_pair_encoder(self, incoming: Hop, outgoing: Hop, size: int) -> PacketPairEncoder:
        """Return a function that encodes a datagram of `size` bytes as two packets, one for each of two hops.

        Pass the encoded packets to `write_blocks`. After `continue_in`, the returned function is invalid,
        because its packets refer to an interface of the previous file.
        """
        first, second = (
            (where, _datagram_header(source, target, size)) for source, target, where in (incoming, outgoing)
        )
        return self._writer.pair_encoder(first, second, size)

    def write_blocks(self, blocks: bytes, pairs: int) -> None:
        """Write the packets of `pairs` datagrams. Functions from `datagram_pair_encoder` encoded `blocks`."""
        self._writer.write_blocks(blocks, 2 * pairs)

    def write_segment(
        self,
        source: Address,
        target: Address,
        data: bytes,
        time: int,
        *,
        interface: Interface = _UNNAMED_INTERFACE,
        comment: str = "",
    ) -> None:
        for start in range(0, len(data), _MAX_SEGMENT_BYTES):
            piece = data[start : start + _MAX_SEGMENT_BYTES]
            self._write_tcp(source, target, _PUSH | _ACK, time, interface, comment, piece)

    def skip_bytes(self, source: Address, target: Address, size: int) -> None:
        """Leave a gap of `size` bytes in a TCP stream of the capture."""
        self._sequence[source, target] = self._sequence.get((source, target), 1) + size & 0xFFFFFFFF

    def write_handshake(
        self, client: Address, server: Address, time: int, *, interface: Interface = _UNNAMED_INTERFACE
    ) -> None:
        first = time // _SEQUENCE_NS & 0xFFFFFFFF
        self._sequence[client, server] = self._sequence[server, client] = first
        self._write_tcp(client, server, _SYN, time, interface)
        self._write_tcp(server, client, _SYN | _ACK, time, interface)
        self._write_tcp(client, server, _ACK, time, interface)

    def write_stream_end(
        self,
        source: Address,
        target: Address,
        time: int,
        *,
        interface: Interface = _UNNAMED_INTERFACE,
        reset: bool = False,
        comment: str = "",
    ) -> None:
        self._write_tcp(source, target, _ACK | (_RST if reset else _FIN), time, interface, comment)

    def drop_connection(self, client: Address, server: Address) -> None:
        for ends in ((client, server), (server, client)):
            self._sequence.pop(ends, None)

    def _write_tcp(  # noqa: PLR0917 - internal; the public methods take keywords
        self,
        source: Address,
        target: Address,
        flags: int,
        time: int,
        interface: Interface,
        comment: str = "",
        data: bytes = b"",
    ) -> None:
        """Write a TCP segment. A SYN or FIN advances the sequence number by one."""
        sent = self._sequence.get((source, target), 1)
        acknowledged = self._sequence.get((target, source), 1) if flags & _ACK else 0
        self._sequence[source, target] = sent + len(data) + bool(flags & (_SYN | _FIN)) & 0xFFFFFFFF
        head = _SEGMENT.pack(source[1], target[1], sent, acknowledged, 5 << 12 | flags, 65535, 0, 0)
        packet = b"".join((_ip_header(source, target, _TCP, 20 + len(data)), head, data))
        self._writer.write((time, packet, len(packet), interface, (comment,) if comment else ()))


@lru_cache(_MAX_HEADERS)
def _datagram_header(source: Address, target: Address, size: int) -> bytes:
    udp = _DATAGRAM.pack(source[1], target[1], 8 + size & 0xFFFF, 0)
    return _ip_header(source, target, _UDP, 8 + size) + udp


def _ip_header(source: Address, target: Address, protocol: int, size: int) -> bytes:
    addresses, total = _addresses_and_sum(source[0], target[0])
    if len(addresses) > 8:
        return _IPV6.pack(6 << 28, size & 0xFFFF, protocol, 64, addresses)
    length = 20 + size & 0xFFFF
    total += 0x4500 + length + 0x4000 + (64 << 8 | protocol)  # the checksum of RFC 791
    total = (total & 0xFFFF) + (total >> 16)
    checksum = ~(total + (total >> 16)) & 0xFFFF
    return _IPV4.pack(0x45, 0, length, 0, 0x4000, 64, protocol, checksum, addresses)


@lru_cache(_MAX_HEADERS)
def _addresses_and_sum(source: str, target: str) -> tuple[bytes, int]:
    ends = [ipaddress.ip_address(host.partition("%")[0]) for host in (source, target)]
    wide = any(end.version == 6 for end in ends)
    addresses = b"".join(_mapped(end) if wide else end.packed for end in ends)
    return addresses, sum(struct.unpack(f">{len(addresses) // 2}H", addresses))


def _mapped(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bytes:
    """Return an address as 16 bytes. An IPv4 address is mapped to IPv6 (RFC 4291, 2.5.5.2)."""
    return address.packed if address.version == 6 else bytes(10) + b"\xff\xff" + address.packed
