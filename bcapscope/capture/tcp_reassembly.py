"""Reassembly of TCP connections from segments in any order (RFC 9293).

Bytes that the capture lacks become an explicit gap, never zeros. Every frame keeps the arrival times of the
packets that carried it.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections import deque
from operator import itemgetter
from typing import NamedTuple

from bcapscope.capture.role_detection import TimedItem
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.codec.stream_splitter import GUARANTEED_BUFFER, StreamPiece, StreamSplitter

REORDER_LIMIT = 1024 * 1024
"""Maximum number of bytes held back while an earlier segment is missing, as in Suricata
(stream.reassembly.depth). TCP windows of controllers and clients stay below 64 KiB.
"""

ACK_LIMIT = 1 << 30
"""Largest TCP window in bytes (RFC 7323, 2.3). An acknowledgement is ignored if it is more than this many
bytes ahead of the reassembled bytes.
"""

MARKS_LIMIT = 128
"""Maximum number of separate arrival times per incomplete frame; 25 MB for all streams together."""

_SEGMENT_COST = 128  # memory in bytes that a held segment needs in addition to its content
_RECENT = 16  # number of latest segments of a stream with which a retransmission is compared
_LONGEST_RECENT = 2048  # number of bytes to compare per segment; more than an Ethernet frame carries
_HEADER = struct.Struct(">4xIIBB")

FIN, SYN, RST, ACK = 1, 2, 4, 16


class TcpSegment(NamedTuple):
    """One TCP segment.

    Attributes:
        flags: Bits of `FIN`, `SYN`, `RST` and `ACK`.
        seq: Sequence number of the first byte, or of the SYN.
        ack: Sequence number that the sender expects next; valid if `ACK` is set.
        missing: Number of content bytes after `data` that the capture lacks.
    """

    flags: int
    seq: int
    ack: int
    data: bytes
    missing: int


def read_segment(payload: bytes, missing: int) -> TcpSegment | None:
    """Parse an IP payload, whose last `missing` bytes the capture lacks; None if the header is invalid."""
    if len(payload) < 20:
        return None
    seq, ack, offset, flags = _HEADER.unpack_from(payload)
    size = (offset >> 4) * 4
    if size < 20 or size > len(payload) + missing:
        return None
    lost = min(missing, len(payload) + missing - size)
    return TcpSegment(flags, seq, ack, payload[size:], lost)


class _StreamPart(NamedTuple):
    start: int
    data: bytes
    time: int
    packet: int


class _ArrivalMark(NamedTuple):
    """Arrival time and packet number of the stream's bytes from offset `start` to `stop`."""

    start: int
    stop: int
    time: int
    packet: int


class TcpStream:
    """One direction of a TCP connection. Offsets in the stream count from the first captured byte.

    Attributes:
        begun: Whether the first sequence number of the stream is known.
        closed: Whether the stream has ended; later bytes are retransmissions or belong to another connection.
        contradictions: Number of retransmissions whose content differs; the first transmission is kept.
    """

    def __init__(self, budget: ByteBudget, templates: FrameTemplates | None = None) -> None:
        self.begun = self.closed = False
        self.contradictions = 0
        self._budget = budget
        self._templates = templates
        self._splitter = StreamSplitter(budget=budget, templates=templates)
        self._first_seq = self._next_offset = self._acknowledged = self._ahead_cost = 0
        self._end_offset: int | None = None
        self._ahead: list[_StreamPart] = []
        self._marks: deque[_ArrivalMark] = deque()
        self._recent: deque[_StreamPart] = deque(maxlen=_RECENT)

    def begin(self, seq: int, from_start: bool) -> None:
        """Start the stream. `seq` is the sequence number of the first byte to reassemble. `from_start` is
        True if the sender sent no byte before this byte.
        """
        self.begun = True
        self._first_seq = seq
        self._splitter = StreamSplitter(from_start, budget=self._budget, templates=self._templates)

    def starts_at(self, seq: int) -> bool:
        return self.begun and seq == self._first_seq

    def is_ahead(self, seq: int) -> bool:
        return self._offset_of(seq) >= self._next_offset

    @property
    def is_waiting(self) -> bool:
        """True if a FIN was captured, or if segments are held because earlier bytes are missing."""
        return bool(self._ahead) or self._end_offset is not None

    def receive_frame(self, segment: TcpSegment, time: int, packet: int) -> TimedItem | None:
        """Fast path: accept a segment that comes next in the stream and holds exactly one frame.

        Call this only while `is_waiting` is False. If this method returns None, call `receive`.
        """
        _, seq, _, data, _ = segment
        if (
            (seq - self._first_seq - self._next_offset) & 0xFFFFFFFF
            or self._marks
            or self.closed
            or not self.begun
        ):
            return None
        frame = self._splitter.feed_whole_frame(data)
        if frame is None:
            return None
        self._keep_recent(_StreamPart(self._next_offset, data, time, packet))
        self._next_offset += len(data)
        return TimedItem(time, time, packet, frame)

    def receive(self, segment: TcpSegment, time: int, packet: int) -> list[TimedItem]:
        if self.closed:
            return []
        start, data = self._offset_of(segment.seq), segment.data
        if segment.flags & FIN:
            self._end_offset = start + len(data) + segment.missing
        if start == self._next_offset and not self._ahead and self._end_offset is None:
            return self._deliver(_StreamPart(start, data, time, packet)) if data else []
        if start < self._next_offset:
            known = data[: self._next_offset - start]
            if (
                len(data) > 1 or start + 1 != self._next_offset
            ):  # excludes a keep-alive probe, whose one byte is not data
                self._count_contradiction(_StreamPart(start, known, time, packet), self._recent)
            start, data = start + len(known), data[len(known) :]
        if data:
            self._hold_ahead(_StreamPart(start, data, time, packet))
        return self._drain_and_skip(time, packet)

    def acknowledge(self, ack: int, time: int, packet: int) -> list[TimedItem]:
        """Record that the receiver has all bytes before `ack`, and return the items that are now complete.

        If bytes before `ack` are missing in the capture, the sender will not send them again.
        """
        offset = self._offset_of(ack)
        if self._acknowledged < offset <= self._next_offset + ACK_LIMIT:
            self._acknowledged = offset
            if self._ahead or self._end_offset is not None:
                return self._drain_and_skip(time, packet)
        return []

    def close(self, time: int, packet: int) -> list[TimedItem]:
        if self.closed:
            return []
        found: list[TimedItem] = []
        while self._ahead:
            found += self._skip_lost(self._ahead[0].start, time, packet)
            found += self._drain_ready()
        # A FIN is acknowledged like a byte. If no FIN was captured, the last acknowledged byte may be a FIN.
        expected = (
            self._acknowledged - 1 if self._end_offset is None else min(self._acknowledged, self._end_offset)
        )
        if expected > self._next_offset:
            found += self._skip_lost(expected, time, packet)
        found += self._with_times(self._splitter.close(), time, packet)
        self.closed = True
        self._marks.clear()
        self._recent.clear()
        return found

    def _offset_of(self, seq: int) -> int:
        """Return the stream offset of `seq`: of all offsets modulo 2**32, the nearest to `_next_offset`."""
        ahead = (seq - self._first_seq - self._next_offset) & 0xFFFFFFFF
        return self._next_offset + (ahead if ahead < 0x80000000 else ahead - 0x100000000)

    def _deliver(self, part: _StreamPart) -> list[TimedItem]:
        start, data, time, packet = part
        self._next_offset = stop = start + len(data)
        self._keep_recent(part)
        self._marks.append(_ArrivalMark(start, stop, time, packet))
        if len(self._marks) > MARKS_LIMIT:
            self._thin_marks()
        return self._with_times(self._splitter.feed(data), time, packet)

    def _keep_recent(self, part: _StreamPart) -> None:
        surplus = len(part.data) - _LONGEST_RECENT
        if surplus > 0:
            part = part._replace(start=part.start + surplus, data=part.data[surplus:])
        self._recent.append(part)

    def _thin_marks(self) -> None:
        """Merge all arrival marks except the first in pairs. A merged mark has the time of its second mark.

        A long frame takes its times from its first and its last arrival mark. Its other arrival marks matter
        only if a wrong length field made several frames look like one.
        """
        marks = list(self._marks)
        kept = [b._replace(start=a.start) for a, b in zip(marks[1::2], marks[2::2], strict=False)]
        self._marks = deque([marks[0], *kept, *marks[1 + 2 * len(kept) :]])

    def _drain_and_skip(self, time: int, packet: int) -> list[TimedItem]:
        """Deliver the held bytes that are now in order, and skip gaps that no segment will fill."""
        found = self._drain_ready()
        while self._ahead and (self._acknowledged >= self._ahead[0].start or self._is_over_limit):
            found += self._skip_lost(self._ahead[0].start, time, packet)
            found += self._drain_ready()
        if self._end_offset is not None and max(self._next_offset, self._acknowledged) >= self._end_offset:
            found += self.close(time, packet)
        return found

    @property
    def _is_over_limit(self) -> bool:
        cost = self._ahead_cost
        return cost > REORDER_LIMIT or (cost > GUARANTEED_BUFFER and self._budget.is_exceeded)

    def _drain_ready(self) -> list[TimedItem]:
        found: list[TimedItem] = []
        count = 0
        for part in self._ahead:
            if part.start != self._next_offset:
                break
            count += 1
            self._charge(-len(part.data) - _SEGMENT_COST)
            found += self._deliver(part)
        del self._ahead[:count]
        return found

    def _skip_lost(self, offset: int, time: int, packet: int) -> list[TimedItem]:
        missing = offset - self._next_offset
        self._next_offset = offset
        return self._with_times(self._splitter.add_gap(missing), time, packet)

    def _hold_ahead(self, part: _StreamPart) -> None:
        start, data, time, packet = part
        stop = start + len(data)
        ahead = self._ahead
        place = max(bisect_right(ahead, start, key=itemgetter(0)) - 1, 0)
        self._count_contradiction(part, ahead[place:])
        while start < stop:
            if place == len(ahead) or start < ahead[place].start:
                until = stop if place == len(ahead) else min(stop, ahead[place].start)
                content = data[start - part.start : until - part.start]
                ahead.insert(place, _StreamPart(start, content, time, packet))
                self._charge(len(content) + _SEGMENT_COST)
                start = until
            else:
                start = max(start, ahead[place].start + len(ahead[place].data))
            place += 1

    def _charge(self, cost: int) -> None:
        self._ahead_cost += cost
        self._budget.held += cost

    def _count_contradiction(self, part: _StreamPart, known: deque[_StreamPart] | list[_StreamPart]) -> None:
        for other in known:
            if other.start >= part.start + len(part.data):
                return
            start = max(part.start, other.start)
            stop = min(part.start + len(part.data), other.start + len(other.data))
            again = part.data[start - part.start : max(stop - part.start, 0)]
            if start < stop and again != other.data[start - other.start : stop - other.start]:
                self.contradictions += 1
                return

    def _with_times(self, pieces: list[StreamPiece], time: int, packet: int) -> list[TimedItem]:
        """Give each frame the times of its segments, and each gap the time at which the gap was detected."""
        found = []
        marks = self._marks
        for start, stop, item in pieces:
            while marks and marks[0].stop <= start:
                marks.popleft()
            if not marks or marks[0].start >= stop:
                found.append(TimedItem(time, time, packet, item))
                continue
            first = last = marks[0]
            for mark in marks if stop > first.stop else ():
                if mark.start >= stop:
                    break
                last = max(last, mark, key=itemgetter(2))
            found.append(TimedItem(first.time, last.time, last.packet, item))
        while pieces and marks and marks[0].stop <= pieces[-1].stop:
            marks.popleft()
        return found


class TcpConnection:
    """Both directions of a TCP connection. `server` is the end that accepted the connection, if known."""

    def __init__(self, budget: ByteBudget, templates: FrameTemplates | None = None) -> None:
        self.streams = (TcpStream(budget, templates), TcpStream(budget, templates))
        self.server: int | None = None

    def is_reopened_by(self, sender: int, segment: TcpSegment) -> bool:
        own, other = self.streams[sender], self.streams[1 - sender]
        if segment.flags & SYN:
            first = (segment.seq + 1) & 0xFFFFFFFF
            return not own.starts_at(first) and (own.begun or (other.begun and not segment.flags & ACK))
        return bool(segment.data) and own.closed and own.is_ahead(segment.seq)

    def receive_in_order(
        self, sender: int, segment: TcpSegment, time: int, packet: int
    ) -> list[TimedItem] | None:
        """Fast path for most segments: segments in order that hold one frame or no data.

        If this method returns None, call `receive` with the same segment.
        """
        own, other = self.streams[sender], self.streams[1 - sender]
        if segment.flags & (FIN | SYN | RST) or own.is_waiting or other.is_waiting:
            return None
        found = []
        if segment.data:
            sighting = own.receive_frame(segment, time, packet)
            if sighting is None:
                return None
            found.append(sighting)
        if segment.flags & ACK and other.begun:
            other.acknowledge(segment.ack, time, packet)
        return found

    def receive(
        self, sender: int, segment: TcpSegment, time: int, packet: int
    ) -> list[tuple[int, TimedItem]]:
        """Accept a segment; return the items that are now complete, each with the index of its sender."""
        own, other = self.streams[sender], self.streams[1 - sender]
        found = []
        if segment.flags & ACK and other.begun:
            lost = other.acknowledge(segment.ack, time, packet)
            found = [(1 - sender, sighting) for sighting in lost] if lost else []
        if segment.flags & RST:
            return found + self.close(time, packet)
        if segment.flags & SYN:
            self.server = sender if segment.flags & ACK else 1 - sender
            segment = segment._replace(seq=(segment.seq + 1) & 0xFFFFFFFF)
            if not own.begun:
                own.begin(segment.seq, from_start=True)
        if segment.data and not own.begun:
            own.begin(segment.seq, from_start=False)
        if own.begun:
            found += [(sender, sighting) for sighting in own.receive(segment, time, packet)]
        return found

    def close(self, time: int, packet: int) -> list[tuple[int, TimedItem]]:
        """End both directions; return their remaining items, each with the index of its sender."""
        return [
            (sender, sighting)
            for sender, stream in enumerate(self.streams)
            for sighting in stream.close(time, packet)
        ]
