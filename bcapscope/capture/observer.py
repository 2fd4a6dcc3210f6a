"""From captured packets to observations: who said what, and when."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Iterator
from sys import getsizeof

from bcapscope.capture.connections import Connections
from bcapscope.capture.counts import Counts
from bcapscope.capture.fragments import Fragments
from bcapscope.capture.link import ETHERNET, LINKS, NOT_IP, IPPacket, find_ip, read_ip
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.sides import PORTS
from bcapscope.capture.talk import Sighting
from bcapscope.capture.tcp import read_segment
from bcapscope.capture.udp import Datagrams
from bcapscope.errors import CaptureError
from bcapscope.protocol.frame import EOT, SMALLEST_FRAME, SOH, Frame, Malformed, Problem
from bcapscope.traffic.observation import Conversation, Flow, Observation

CONVERSATIONS_LIMIT = 10_000
"""Conversations that are listed; a flood of forged addresses would fill the memory with them."""

COMMENTS_LIMIT = 4096
"""Packets whose comments are kept, which is until those who look at their frames have had time to ask."""

COMMENTS_BYTES = 4 * 1024 * 1024
"""Bytes of all these comments. Beyond that the oldest are dropped, except those of the latest packet."""

_TCP, _UDP = 6, 17
_UDP_HEADER_SIZE = 8
_UNSEEN = Malformed(b"", ())

_UDP_IN_ETHERNET = struct.Struct(">12xHBxHxxHxBxx12sH")
"""Type; version and header size, length, fragmentation, protocol of IPv4; addresses and ports; UDP length."""

_SMALLEST_IN_ETHERNET = 42 + SMALLEST_FRAME
_SOH_AND_LENGTH = struct.Struct("<BI")


class Observer:
    """Turns packets into observations.

    Attributes:
        counts: what became of the packets so far.
        comments: of the packets that have any, by number; the latest `COMMENTS_LIMIT` packets.
        ended: when the latest packet was captured, whatever was in it, nanoseconds since 1970; 0 before that.
            Known once there are no more.
    """

    def __init__(self, ports: Collection[int] = PORTS, leg: str = "") -> None:
        """Begin.

        Args:
            ports: on which servers listen; other conversations are told by what is said in them.
            leg: only what was captured on interfaces whose names begin so is looked at.
        """
        self.counts = Counts()
        self.comments: dict[int, tuple[str, ...]] = {}
        self._comments_size = 0
        self.ended = 0
        self._conversations: dict[Conversation, None] = {}
        self._leg = leg
        self._datagrams = Datagrams(ports, self.counts)
        self._connections = Connections(ports, self.counts)
        self._fragments = Fragments()

    @property
    def conversations(self) -> tuple[Conversation, ...]:
        """Those observed, in order; each says how its server was told. At most `CONVERSATIONS_LIMIT`."""
        return tuple(self._conversations)

    def observe(self, packets: Iterable[Packet]) -> Iterator[Observation]:
        """Yield an observation for each frame, for bytes where a frame should be, and for each hole.

        They come as they are completed; what is said before it is known which end is the server comes as
        soon as it is. Called again, numbers go on.

        Raises:
            CaptureError: as `packets` does, after all that was seen until then.
        """
        counts, broken = self.counts, None
        number, packet, time = counts.items, counts.packets, 0
        interface, ethernet, wanted = None, False, True
        flow_of, new = self._datagrams.flows.get, tuple.__new__
        unpack, begin_of = _UDP_IN_ETHERNET.unpack_from, _SOH_AND_LENGTH.unpack_from
        try:
            for time, data, original, source, comments in packets:
                packet += 1
                if comments:
                    self._keep(packet, comments)
                if source is not interface:
                    interface, ethernet = source, source.linktype == ETHERNET
                    wanted = source.name.startswith(self._leg)
                if not wanted:
                    continue
                if ethernet and len(data) >= _SMALLEST_IN_ETHERNET:  # nearly all packets of a session
                    kind, version, total, part, protocol, key, size = unpack(data)
                    flow = flow_of(key)
                    if flow is not None and kind == 0x0800 and version == 0x45 and protocol == _UDP:
                        soh, length = begin_of(data, 42)
                        raw = data[42 : 42 + length]
                        whole = total - 28 == size - 8 == length == len(raw) and not part & 0x3FFF
                        if whole and length >= SMALLEST_FRAME and soh == SOH and raw[-1] == EOT:
                            number += 1
                            yield new(Observation, (number, time, time, flow, Frame(raw), packet))
                            continue
                counts.packets = packet
                for flow, sighting in self._take(time, data, original, source, packet):
                    number += 1
                    yield self._observation(number, flow, sighting)
        except CaptureError as error:
            broken = error
        finally:
            counts.packets = packet
            counts.items = number
            self.ended = max(self.ended, time)
        for flow, sighting in self._finish(time, packet):
            counts.items += 1
            yield self._observation(counts.items, flow, sighting)
        if broken is not None:
            raise broken

    def _keep(self, packet: int, comments: tuple[str, ...]) -> None:
        self.comments[packet] = comments
        self._comments_size += sum(map(getsizeof, comments))
        while len(self.comments) > COMMENTS_LIMIT or (
            len(self.comments) > 1 and self._comments_size > COMMENTS_BYTES
        ):
            oldest = self.comments.pop(next(iter(self.comments)))
            self._comments_size -= sum(map(getsizeof, oldest))

    def _observation(self, number: int, flow: Flow, sighting: Sighting) -> Observation:
        began, time, packet, item = sighting
        if isinstance(item, Malformed):
            if item.missing:
                self.counts.gaps += 1
                self.counts.missing += item.missing
            else:
                self.counts.malformed += 1
        if len(self._conversations) < CONVERSATIONS_LIMIT:
            self._conversations[flow.conversation] = None
        return Observation(number, time, began, flow, item, packet)

    def _take(
        self, time: int, data: bytes, original: int, interface: Interface, packet: int
    ) -> list[tuple[Flow, Sighting]]:
        """Follow any packet through all of its headers."""
        cut = original > len(data)
        self.counts.cut += cut
        ip = self._unwrap(data, interface.linktype)
        if ip is None:
            return []
        began = time
        if ip.fragment is not None:
            whole = self._fragments.add(ip, time)
            self.counts.fragments_lost = self._fragments.lost
            if whole is None:
                return []
            ip, began = whole
        if ip.protocol == _TCP:
            return self._take_tcp(ip, time, packet)
        if ip.protocol == _UDP:
            return self._take_udp(ip, cut, Sighting(began, time, packet, _UNSEEN))
        self.counts.not_bcap += 1
        return []

    def _unwrap(self, data: bytes, linktype: int) -> IPPacket | None:
        if linktype not in LINKS:
            self.counts.unknown_links[linktype] += 1
            return None
        offset = find_ip(linktype, data)
        if offset == NOT_IP:
            self.counts.not_ip += 1
            return None
        ip = read_ip(data, offset)
        self.counts.broken += ip is None
        return ip

    def _take_udp(self, ip: IPPacket, cut: bool, sighting: Sighting) -> list[tuple[Flow, Sighting]]:
        there = len(ip.payload) + ip.missing
        size = int.from_bytes(ip.payload[4:6]) or there  # 0 where the network card is to fill it in
        if len(ip.payload) < _UDP_HEADER_SIZE or size < _UDP_HEADER_SIZE:
            self.counts.broken += 1
            return []
        segment = ip.payload[:size]
        note = _why_short(len(segment), size, cut) if len(segment) < size else None
        return self._datagrams.receive(ip.addresses, segment, sighting, note)

    def _take_tcp(self, ip: IPPacket, time: int, packet: int) -> list[tuple[Flow, Sighting]]:
        segment = read_segment(ip.payload, ip.missing)
        if segment is None:
            self.counts.broken += 1
            return []
        return self._connections.receive(ip.addresses + ip.payload[:4], segment, time, packet)

    def _finish(self, time: int, packet: int) -> list[tuple[Flow, Sighting]]:
        """Let go of all that was held back, since nothing more comes."""
        found = self._datagrams.close() + self._connections.close(time, packet)
        self._fragments.close()
        self.counts.fragments_lost = self._fragments.lost
        self.counts.contradictions = self._connections.contradictions
        return found


def _why_short(there: int, size: int, cut: bool) -> Problem:
    there, size = there - _UDP_HEADER_SIZE, size - _UDP_HEADER_SIZE
    who = "the capture kept" if cut else "the packet holds"
    return Problem(there, "cut", f"{who} {there} of the datagram's {size} bytes")
