"""Decode captured packets into observations."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterable, Iterator
from sys import getsizeof

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.ip_reassembly import IpReassembly
from bcapscope.capture.link_layer import ETHERNET, IP_OFFSET_FINDERS, NOT_IP, IPPacket, find_ip, read_ip
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.role_detection import BCAP_PORTS, TimedItem
from bcapscope.capture.tcp_conversations import TcpConversations
from bcapscope.capture.tcp_reassembly import read_segment
from bcapscope.capture.tunnel import DEEPEST_TUNNEL, packet_in_tunnel
from bcapscope.capture.udp_conversations import UdpConversations
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import EOT, SMALLEST_FRAME, SOH, Frame, Malformed, Problem
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.observation import Conversation, Flow, Observation

CONVERSATIONS_LIMIT = 10_000
"""Maximum size of `PacketDecoder.conversations`. A limit is necessary, because addresses can be forged."""

COMMENTS_LIMIT = 4096
"""Maximum number of packets whose comments are kept. Comments are used only shortly after decoding."""

COMMENTS_BYTES = 4 * 1024 * 1024
"""Maximum size of all kept comments in bytes. The comments of the latest packet are always kept."""

_TCP, _UDP = 6, 17
_UDP_HEADER_SIZE = 8

_UDP_IN_ETHERNET = struct.Struct(">12xHBxHxxHxBxx12sH")
"""Big-endian header fields of a UDP packet over Ethernet: Ethernet type; IPv4 version and header size,
length, fragmentation, protocol; addresses with ports; UDP length.
"""

_SMALLEST_IN_ETHERNET = 42 + SMALLEST_FRAME
_SOH_AND_LENGTH = struct.Struct("<BI")


class PacketComments(dict[int, tuple[str, ...]]):
    """Comments of packets; the key is the packet number. The oldest comments are dropped."""

    _size = 0

    def add(self, packet: int, comments: tuple[str, ...]) -> None:
        self[packet] = comments
        self._size += sum(map(getsizeof, comments))
        while len(self) > COMMENTS_LIMIT or (len(self) > 1 and self._size > COMMENTS_BYTES):
            self._size -= sum(map(getsizeof, self.pop(next(iter(self)))))


class PacketDecoder:
    """Turns packets into observations.

    Attributes:
        counts: Numbers of packets and observations so far.
        note_packet: Receives a frame number and the number of the frame's packet. A frame may be left out if
            its packet directly follows the previous frame's packet.
        end_time: Latest capture time of all packets of any protocol, ns since 1970; 0 before the first.
    """

    def __init__(self, ports: Collection[int] = BCAP_PORTS, interface_prefix: str = "") -> None:
        """The end whose port is in `ports` is the controller. If neither end or both ends have such a port,
        the TCP handshake or the content of the frames shows which end is the controller.

        Packets of interfaces whose name does not begin with `interface_prefix` are ignored.
        """
        self.counts = CaptureCounts()
        self.note_packet: Callable[[int, int], object] = lambda frame, packet: None
        self.comments = PacketComments()
        self.end_time = 0
        self._conversations: dict[Conversation, None] = {}
        self._interface_prefix = interface_prefix
        self._templates = FrameTemplates()
        self._udp = UdpConversations(ports, self.counts, self._templates)
        self._tcp = TcpConversations(ports, self.counts, self._templates)
        self._fragments = IpReassembly(self.counts)

    @property
    def conversations(self) -> tuple[Conversation, ...]:
        """The first `CONVERSATIONS_LIMIT` conversations, in the order of their first observation."""
        return tuple(self._conversations)

    def decode(self, packets: Iterable[Packet]) -> Iterator[Observation]:
        """Yield an observation for each frame, for each run of bytes that are not a frame, and for each gap.

        The observations of a conversation are held back while its controller is unknown. If `decode` is
        called again, the observation numbers continue. Raises CaptureError if the capture is damaged, but
        only after all observations before the damage.
        """
        counts, broken = self.counts, None
        number, packet, time, latest = counts.items, counts.packets, 0, self.end_time
        interface, ethernet, wanted = None, False, True
        # The fast path need not call `note`: frame number and packet number both grow by one per packet.
        note = self.note_packet
        flow_of, new, templates = self._udp.flows.get, tuple.__new__, self._templates
        unpack, begin_of = _UDP_IN_ETHERNET.unpack_from, _SOH_AND_LENGTH.unpack_from
        try:
            for time, data, original, source, comments in packets:
                packet += 1
                self.end_time = latest = time if time > latest else latest  # cheaper than max() per packet
                if comments:
                    self.comments.add(packet, comments)
                if source is not interface:
                    interface, ethernet = source, source.linktype == ETHERNET
                    wanted = source.name.startswith(self._interface_prefix)
                if not wanted:
                    note(number + 1, packet + 1)
                    continue
                if ethernet and len(data) >= _SMALLEST_IN_ETHERNET:  # fast path for most packets
                    kind, version, total, part, protocol, key, size = unpack(data)
                    flow = flow_of(key)
                    if flow is not None and kind == 0x0800 and version == 0x45 and protocol == _UDP:
                        soh, length = begin_of(data, 42)
                        raw = data[42 : 42 + length]
                        whole = total - 28 == size - 8 == length == len(raw) and not part & 0x3FFF
                        if whole and length >= SMALLEST_FRAME and soh == SOH and raw[-1] == EOT:
                            number += 1
                            yield new(
                                Observation, (number, time, time, flow, Frame(raw, None, templates), packet)
                            )
                            continue
                counts.packets = packet
                for flow, sighting in self._decode_any(time, data, original, source, packet):
                    number += 1
                    flow.conversation.interface = flow.conversation.interface or source.name
                    note(number, sighting.packet)
                    yield self._make_observation(number, flow, sighting)
                note(number + 1, packet + 1)
        except CaptureError as error:
            broken = error
        finally:
            counts.packets = packet
            counts.items = number
        for flow, sighting in self._flush(time, packet):
            counts.items += 1
            note(counts.items, sighting.packet)
            yield self._make_observation(counts.items, flow, sighting)
        if broken is not None:
            raise broken

    def _make_observation(self, number: int, flow: Flow, timed_item: TimedItem) -> Observation:
        began, time, packet, item = timed_item
        if isinstance(item, Malformed):
            if item.missing:
                self.counts.gaps += 1
                self.counts.missing += item.missing
            else:
                self.counts.malformed += 1
        if len(self._conversations) < CONVERSATIONS_LIMIT:
            self._conversations[flow.conversation] = None
        return Observation(number, time, began, flow, item, packet)

    def _decode_any(
        self, time: int, data: bytes, original: int, interface: Interface, packet: int
    ) -> list[tuple[Flow, TimedItem]]:
        cut = original > len(data)
        self.counts.cut += cut
        ip = self._find_ip_packet(data, interface.linktype)
        if ip is None:
            return []
        whole = self._fragments.add(ip, time)
        for _ in range(DEEPEST_TUNNEL):
            carried = None if whole is None else packet_in_tunnel(whole[0])
            if carried is None:
                break
            whole = self._fragments.add(carried, time)
        if whole is None:
            return []
        ip, began = whole
        if ip.protocol == _TCP:
            return self._decode_tcp(ip, time, packet)
        if ip.protocol == _UDP:
            return self._decode_udp(ip, cut, (began, time, packet))
        self.counts.not_bcap += 1
        return []

    def _find_ip_packet(self, data: bytes, linktype: int) -> IPPacket | None:
        if linktype not in IP_OFFSET_FINDERS:
            self.counts.unknown_links[linktype] += 1
            return None
        offset = find_ip(linktype, data)
        if offset == NOT_IP:
            self.counts.not_ip += 1
            return None
        ip = read_ip(data, offset)
        self.counts.broken += ip is None
        return ip

    def _decode_udp(
        self, ip: IPPacket, cut: bool, arrival: tuple[int, int, int]
    ) -> list[tuple[Flow, TimedItem]]:
        there = len(ip.payload) + ip.missing
        # the length is 0 if the network card fills it in later
        size = int.from_bytes(ip.payload[4:6]) or there
        if len(ip.payload) < _UDP_HEADER_SIZE or size < _UDP_HEADER_SIZE:
            self.counts.broken += 1
            return []
        segment = ip.payload[:size]
        note = _truncation_problem(len(segment), size, cut) if len(segment) < size else None
        return self._udp.receive(ip.addresses, segment, arrival, note)

    def _decode_tcp(self, ip: IPPacket, time: int, packet: int) -> list[tuple[Flow, TimedItem]]:
        segment = read_segment(ip.payload, ip.missing)
        if segment is None:
            self.counts.broken += 1
            return []
        return self._tcp.receive(ip.addresses + ip.payload[:4], segment, time, packet)

    def _flush(self, time: int, packet: int) -> list[tuple[Flow, TimedItem]]:
        self._fragments.close()
        return self._udp.close() + self._tcp.close(time, packet)


def _truncation_problem(there: int, size: int, cut: bool) -> Problem:
    there, size = there - _UDP_HEADER_SIZE, size - _UDP_HEADER_SIZE
    case = "problem.cut.by-capture" if cut else "problem.cut.in-packet"
    return Problem(there, "cut", Message(case, kept=there, size=size))
