"""TCP conversations of a capture: find and reassemble b-CAP connections, and detect the controllers."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.capture.role_detection import (
    TimedItem,
    UndecidedConversation,
    endpoints_of,
    may_begin_frame,
    reverse_key,
    server_index_by_port,
)
from bcapscope.capture.tcp_reassembly import FIN, RST, SYN, TcpConnection, TcpSegment
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import SMALLEST_FRAME
from bcapscope.protocol.codec.frame_content import FrameContent
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.observation import SERVER_PORT, Flow, ServerEvidence, ServerEvidenceKind, Transport

CONNECTIONS_LIMIT = 1024
"""Maximum number of TCP connections at a time. When another connection begins, bcapscope drops the connection
that has been idle for the longest time.
"""


_HANDSHAKE = ServerEvidence(ServerEvidenceKind.HANDSHAKE)


class _TrackedConnection:
    """A TCP connection and its conversation. `keys` holds the key of each sender, or only one key if both
    ends are the same, as in a forged packet.
    """

    def __init__(self, key: bytes, connection: TcpConnection) -> None:
        self.keys = (key, reverse_key(key)) if key != reverse_key(key) else (key,)
        self.ends = endpoints_of(key)
        self.connection = connection
        self.conversation: UndecidedConversation | None = None
        # number of segments received while it was not certain that the protocol is b-CAP
        self.unconfirmed_segments = 0


class TcpConversations:
    def __init__(
        self, ports: Collection[int], counts: CaptureCounts, templates: FrameTemplates | None = None
    ) -> None:
        """An end whose port is in `ports` is a controller. This class updates `contradictions` and `not_bcap`
        in `counts`.
        """
        self._ports = ports
        self._counts = counts
        self._budget = ByteBudget()
        self._templates = templates
        self._connections: OrderedDict[bytes, tuple[_TrackedConnection, int]] = OrderedDict()
        self._most_recent: _TrackedConnection | None = None

    def receive(
        self, key: bytes, segment: TcpSegment, time: int, packet: int
    ) -> list[tuple[Flow, TimedItem]]:
        """Accept a TCP segment, and return each item that now has a flow. `key` holds source address,
        destination address, source port and destination port, as in the packet.
        """
        known = self._connections.get(key)
        if known is not None:
            usual = self._receive_in_order(*known, segment, time, packet)
            if usual is not None:
                return usual
        found: list[tuple[Flow, TimedItem]] = []
        if known is not None and known[0].connection.is_reopened_by(known[1], segment):
            found = self._end_connection(known[0], time, packet)
            known = None
        if known is None:
            if not segment.data and not segment.flags & SYN:
                return []
            if len(self._connections) >= 2 * CONNECTIONS_LIMIT:
                found += self._end_connection(next(iter(self._connections.values()))[0], time, packet)
            known = self._open_connection(key)
        self._touch(known[0])
        return found + self._receive_any(*known, segment, time, packet)

    def close(self, time: int, packet: int) -> list[tuple[Flow, TimedItem]]:
        found: list[tuple[Flow, TimedItem]] = []
        while self._connections:
            found += self._end_connection(next(iter(self._connections.values()))[0], time, packet)
        return found

    def _receive_in_order(
        self, tracked: _TrackedConnection, sender: int, segment: TcpSegment, time: int, packet: int
    ) -> list[tuple[Flow, TimedItem]] | None:
        """Fast path for most segments of a conversation whose controller is known. If this method returns
        None, call `_receive_any` with the same segment.
        """
        conversation = tracked.conversation
        flows = None if conversation is None or conversation.is_tentative else conversation.flows
        if flows is None:
            return None
        items = tracked.connection.receive_in_order(sender, segment, time, packet)
        if items is None:
            return None
        self._touch(tracked)
        return [(flows[sender], item) for item in items]

    def _touch(self, tracked: _TrackedConnection) -> None:
        if tracked is not self._most_recent:
            self._most_recent = tracked
            for each in tracked.keys:
                self._connections.move_to_end(each)

    def _open_connection(self, key: bytes) -> tuple[_TrackedConnection, int]:
        tracked = _TrackedConnection(key, TcpConnection(self._budget, self._templates))
        source, destination = tracked.ends
        server = server_index_by_port(self._ports, source.port, destination.port)
        if server is not None:
            tracked.conversation = UndecidedConversation(tracked.ends, Transport.TCP)
            tracked.conversation.set_server(server, SERVER_PORT)
        elif source.port in self._ports:
            tracked.conversation = UndecidedConversation(tracked.ends, Transport.TCP)
        for sender, each in enumerate(tracked.keys):
            self._connections[each] = tracked, sender
        return tracked, 0

    def _receive_any(
        self, tracked: _TrackedConnection, sender: int, segment: TcpSegment, time: int, packet: int
    ) -> list[tuple[Flow, TimedItem]]:
        if tracked.conversation is None and segment.data:
            tracked.conversation = _recognise_bcap(tracked, sender, segment)
            if tracked.conversation is None:
                tracked.unconfirmed_segments = 1
                self._reset_as_not_bcap(tracked)
                return []
        items = tracked.connection.receive(sender, segment, time, packet)
        if tracked.conversation is None:
            return []
        tracked.unconfirmed_segments += tracked.conversation.is_tentative and bool(segment.data)
        if segment.flags & (FIN | RST):
            tracked.conversation.record_close(sender, bool(segment.flags & RST), time)
        if tracked.conversation.flows is None and tracked.connection.server is not None:
            tracked.conversation.set_server(tracked.connection.server, _HANDSHAKE)
        if not all(tracked.conversation.add_item(each, item) for each, item in items):
            self._reset_as_not_bcap(tracked)
            return []
        return tracked.conversation.release_items()

    def _reset_as_not_bcap(self, tracked: _TrackedConnection) -> None:
        self._counts.not_bcap += tracked.unconfirmed_segments
        tracked.connection.close(0, 0)
        tracked.conversation, tracked.unconfirmed_segments = None, 0
        tracked.connection = TcpConnection(self._budget, self._templates)

    def _end_connection(
        self, tracked: _TrackedConnection, time: int, packet: int
    ) -> list[tuple[Flow, TimedItem]]:
        for key in tracked.keys:
            del self._connections[key]
        self._counts.contradictions += sum(each.contradictions for each in tracked.connection.streams)
        if tracked.conversation is None:
            return []
        items = tracked.connection.close(time, packet)
        if not all(tracked.conversation.add_item(sender, item) for sender, item in items):
            self._reset_as_not_bcap(tracked)
            return []
        tracked.conversation.guess_server()
        return tracked.conversation.release_items()


def _recognise_bcap(
    tracked: _TrackedConnection, sender: int, segment: TcpSegment
) -> UndecidedConversation | None:
    """Return a conversation if a segment between unknown ports looks like b-CAP; else None.

    If the segment holds the first byte after a captured SYN, it must begin like a frame. Any other segment
    must begin with a whole, undamaged frame.
    """
    if not may_begin_frame(segment.data):
        return None
    if tracked.connection.streams[sender].starts_at(segment.seq):
        return UndecidedConversation(tracked.ends, Transport.TCP, is_tentative=True)
    length = int.from_bytes(segment.data[1:5], "little")
    whole = SMALLEST_FRAME <= length <= len(segment.data) and not FrameContent(segment.data[:length]).problems
    return UndecidedConversation(tracked.ends, Transport.TCP) if whole else None
