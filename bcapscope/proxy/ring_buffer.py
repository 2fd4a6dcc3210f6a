"""A ring buffer in shared memory, through which the relay passes its traffic to the watcher process.

A write takes about a microsecond, makes no system call and never waits. If the ring has no room for a record,
the record is lost and counted. A reader may see the new write position before it sees all bytes of the new
record, because the processor may reorder the two writes. So a reader leaves a new record in the ring until
the reader's next poll.
"""

from __future__ import annotations

import struct
from collections import deque
from enum import IntEnum
from typing import NamedTuple, TypeAlias

from bcapscope.transport.receive_timestamps import AncillaryData, kernel_timestamp

RING_OVERHEAD = 1 << 17
"""Size in bytes of the parts of the shared memory outside the ring: the header and the margin."""

_HEADER_SIZE = 4096
"""Size in bytes of the header, which holds the positions in the ring, `urgency`, `counts` and `figures`."""

_MARGIN = RING_OVERHEAD - _HEADER_SIZE
"""Size in bytes of the margin: memory after the end of the ring, so that a record near the end need not be
split. The ring accepts no record that is larger than the margin. `RING_OVERHEAD` is a multiple of every page
size, because systems round shared memory up to pages.
"""

SET_POINT_DEADLINE_NS = 2_000_000
"""Time in ns within which the controller must answer a set point (DENSO Wave 2009, How to use the Slave
mode)."""

BATCH_SIZE = 16
"""Number of datagrams that the relay collects before it writes them to the ring."""

DELAY_FIGURES = 9
"""Number of values that the watcher process writes for the relay: the fields of `RelayDelays`, in order."""

MAX_WAITING_NOTICES = 1024
"""If this many records wait, further messages for the user are lost and counted."""

_HEAD = struct.Struct("=IBBHIIqq")
_HOLE = struct.Struct("=QQ")
_WRITTEN, _READ, _AHEAD, _URGENCY = range(4)  # header indices, 8 bytes each
_COUNTS, _FIGURES = 8, 64
_PADDING = tuple(bytes(-length % 8) for length in range(8))


class RingRecordKind(IntEnum):
    """Kind of event that a record describes."""

    DATA = 0
    """Data that the relay received or sent: a datagram, or bytes of a stream."""
    CLIENT_OPENED = 1
    """A new client; `data` holds its `ClientEndpoints` as JSON."""
    END = 2
    """A FIN that the relay received or sent. If the relay ended the stream, `data` is the reason."""
    CLIENT_CLOSED = 3
    """The relay removed a client; `data` is the encoded reason."""
    NOTICE = 4
    """A message for the user, encoded with `encode_message`."""
    RESET = 5
    """An RST, which ends both directions. If the relay reset the connection, `data` is the reason."""
    HOLE = 6
    """Bytes of a stream that are missing because the ring was full; see `hole_sizes`."""


class RelayCounter(IntEnum):
    """Indices of the counters that the relay keeps in the ring."""

    CAME_UP = 0
    """Datagrams received from clients."""
    LEFT_UP = 1
    """Datagrams sent to controllers."""
    CAME_DOWN = 2
    LEFT_DOWN = 3
    BYTES_UP = 4
    """Number of bytes that the relay sent to controllers over TCP."""
    BYTES_DOWN = 5
    FULL = 6
    """Datagrams that the operating system refused to send."""
    LOST = 7
    """Datagrams that the operating system dropped because the receive buffer of a socket was full."""
    DENIED = 8
    """Rejected datagrams and connections."""
    CLIENTS = 9
    """Clients since the start."""
    UNWATCHED = 10
    """Records that were lost because the ring was full."""
    RULED = 11
    """Received datagrams and pieces of streams that a rule of the proxy affected."""


_RECEIVED, _SENT = (
    (int(RelayCounter.CAME_DOWN), int(RelayCounter.CAME_UP)),
    (int(RelayCounter.LEFT_DOWN), int(RelayCounter.LEFT_UP)),
)
_DATA = int(RingRecordKind.DATA)
_KINDS = tuple(RingRecordKind)


class RingRecord(NamedTuple):
    """One event in the relay. Times are in ns since 1970.

    Attributes:
        up: True from client to controller, False from controller to client.
        client: Number of the client; 0 if the event concerns no client.
        received_at: Time of receipt or of the event; 0 for data that was only sent.
        sent_at: Time just before sending, so that a reply is never older than its request; 0 if not sent yet.
        data: Content of the record, as `kind` defines it.
        note: What a rule did to the data, encoded with `encode_message`; b"" without effect.
    """

    kind: RingRecordKind
    up: bool
    client: int
    received_at: int
    sent_at: int
    data: bytes
    note: bytes


def hole_sizes(record: RingRecord) -> tuple[int, int]:
    """Return how many received bytes and how many sent bytes are missing according to a `HOLE` record."""
    received, sent = _HOLE.unpack(record.data)
    return received, sent


class _Hole(NamedTuple):
    """How many received and how many sent bytes of one direction are missing, and the times in ns at which
    the last missing bytes were received and sent.
    """

    received: int = 0
    sent: int = 0
    received_at: int = 0
    sent_at: int = 0


class _Ring:
    def __init__(self, memory: memoryview) -> None:
        """Use zeroed shared memory. Its size is `RING_OVERHEAD` plus a multiple of 8 bytes."""
        self._marks = memory[:_HEADER_SIZE].cast("Q")
        self._space = memory[_HEADER_SIZE:]
        self._size = len(memory) - RING_OVERHEAD
        self.counts = self._marks[_COUNTS : _COUNTS + len(RelayCounter)]
        self.figures = self._marks[_FIGURES : _FIGURES + DELAY_FIGURES]

    @property
    def bytes_written(self) -> int:
        return self._marks[_WRITTEN]

    @property
    def fill_ratio(self) -> float:
        """Share of the ring that unread records occupy, from 0 to 1."""
        return (self._marks[_WRITTEN] - self._marks[_READ]) / self._size

    @property
    def urgency(self) -> int:
        """How urgently the watcher must read, as a number of `WatcherUrgency`. The relay sets it."""
        return self._marks[_URGENCY]

    @urgency.setter
    def urgency(self, value: int) -> None:
        self._marks[_URGENCY] = value

    def release(self) -> None:
        for view in (self.counts, self.figures, self._marks, self._space):
            view.release()


_Entry: TypeAlias = "tuple[RingRecordKind, bool, int, int, int, bytes | memoryview, bytes]"
"""Fields of a `RingRecord` before it is written."""

PendingDatagram: TypeAlias = tuple[bool, int, AncillaryData, int, bytes]
"""Fields: True if from the client, client number, ancillary data, sending time in ns or 0, bytes."""


class RingWriter(_Ring):
    """Writes the relay's records to the ring.

    Attributes:
        counts: Counters of the relay, indexed by `RelayCounter`; the relay increases them in place.
        figures: Delays that the watcher measured; see `DELAY_FIGURES`.
        pending_datagrams: Datagrams to which the relay appends until it calls `flush`.
        streams: Numbers of the TCP clients. If the ring is too full for the bytes of such a client, a `HOLE`
            record later says how many bytes are missing.
    """

    def __init__(self, memory: memoryview) -> None:
        super().__init__(memory)
        self._written = 0
        self._required: deque[_Entry] = deque()
        self._is_reader_detached = False
        self._holes: dict[tuple[int, bool], _Hole] = {}
        self.pending_datagrams: list[PendingDatagram] = []
        self.streams: set[int] = set()

    def flush(self) -> None:
        """Write the pending datagrams to the ring, and count them."""
        datagrams = self.pending_datagrams
        if not datagrams:
            return
        counts, size = self.counts, 0
        parts: list[bytes] = []
        for up, client, control, sent_at, data in datagrams:
            length = len(data)
            need = 39 + length & ~7
            size += need
            received_at = kernel_timestamp(control, sent_at)
            head = _HEAD.pack(need, _DATA, up, 0, client, length, received_at, sent_at)
            parts += (head, data, _PADDING[length & 7])
            counts[_RECEIVED[up]] += 1
            if sent_at:
                counts[_SENT[up]] += 1
        written = self._written
        place = written % self._size
        if self._required or place + size > self._size or written + size - self._marks[_READ] > self._size:
            for up, client, control, sent_at, data in datagrams:
                self._write_or_count(
                    (RingRecordKind.DATA, up, client, kernel_timestamp(control, sent_at), sent_at, data, b"")
                )
        else:
            self._space[place : place + size] = b"".join(parts)
            self._marks[_WRITTEN] = self._written = written + size
        datagrams.clear()

    @property
    def bytes_read(self) -> int:
        """Number of bytes that the faster reader has read so far."""
        return max(self._marks[_READ], self._marks[_AHEAD])

    def detach_reader(self) -> None:
        """Discard waiting records, because the watcher process is gone."""
        self._is_reader_detached = True
        self._required.clear()

    def write_record(
        self,
        up: bool,
        client: int,
        received_at: int,
        sent_at: int,
        data: bytes | memoryview,
        *,
        note: bytes = b"",
    ) -> bool:
        """Write a record. If the ring has no room, count the record as `UNWATCHED` and return False."""
        self.flush()
        return self._write_or_count((RingRecordKind.DATA, up, client, received_at, sent_at, data, note))

    def _write_or_count(self, entry: _Entry) -> bool:
        kind, _, client, _, _, data, note = entry
        size = len(data) + len(note)
        if (
            (self._required and not self._write_waiting())
            or (
                self._holes
                and kind is not RingRecordKind.CLIENT_OPENED
                and not self._write_holes(client, size)
            )
            or not self._write(entry)
        ):
            self._count_lost(entry)
            return False
        return True

    def _count_lost(self, entry: _Entry) -> None:
        """Count a lost record, and remember how many bytes are missing in the client's stream."""
        kind, up, client, received_at, sent_at, data, _ = entry
        self.counts[RelayCounter.UNWATCHED] += 1
        if kind is RingRecordKind.DATA and client in self.streams and not self._is_reader_detached:
            hole, size = self._holes.get((client, up), _Hole()), len(data)
            self._holes[client, up] = _Hole(
                hole.received + (size if received_at else 0),
                hole.sent + (size if sent_at else 0),
                received_at or hole.received_at,
                sent_at or hole.sent_at,
            )

    def _write_holes(self, client: int, size: int) -> bool:
        """Write the `HOLE` records of a client. The ring must also have room for the next record, with `size`
        bytes of data and note. Otherwise, write nothing and return False: one long hole is better than many.
        """
        holes = [(up, hole) for up in (True, False) if (hole := self._holes.get((client, up)))]
        if not holes:
            return True
        needed = size + 7 + _HEAD.size + len(holes) * (_HEAD.size + _HOLE.size)  # 7: alignment
        if self._written + needed - self._marks[_READ] > self._size:
            return False
        for up, hole in holes:
            data = _HOLE.pack(hole.received, hole.sent)
            self._write((RingRecordKind.HOLE, up, client, hole.received_at, hole.sent_at, data, b""))
            del self._holes[client, up]
        return True

    def _write(self, entry: _Entry) -> bool:
        kind, up, client, received_at, sent_at, data, note = entry
        length = len(data)
        need = 39 + length + len(note) & ~7
        written, space = self._written, self._space
        if need > _MARGIN or written + need - self._marks[_READ] > self._size:
            return False
        place = written % self._size
        _HEAD.pack_into(space, place, need, kind, up, len(note), client, length, received_at, sent_at)
        place += 32
        end = place + length
        space[place:end] = data
        if note:
            space[end : end + len(note)] = note
        self._marks[_WRITTEN] = self._written = written + need
        return True

    def write_required(
        self,
        kind: RingRecordKind,
        client: int,
        data: bytes,
        received_at: int,
        *,
        sent_at: int = 0,
        up: bool = False,
    ) -> None:
        """Write a record that must not be lost, as soon as the ring has room. Later records wait for it.

        Even if the reader stops, the number of waiting records is limited. A client that disconnects while
        its `CLIENT_OPENED` record waits leaves no records. Beyond `MAX_WAITING_NOTICES` waiting records,
        further messages for the user are lost.
        """
        self.flush()
        if self._is_reader_detached or (
            kind is RingRecordKind.CLIENT_CLOSED and self._remove_unseen_client(client)
        ):
            return
        if kind is RingRecordKind.NOTICE and len(self._required) >= MAX_WAITING_NOTICES:
            self.counts[RelayCounter.UNWATCHED] += 1
            return
        self._required.append((kind, up, client, received_at, sent_at, data, b""))
        self._write_waiting()

    def _remove_unseen_client(self, client: int) -> bool:
        """Discard a client's waiting records if its `CLIENT_OPENED` record is among them."""
        if not any(
            kind is RingRecordKind.CLIENT_OPENED and number == client
            for kind, _, number, *_ in self._required
        ):
            return False
        for up in (True, False):
            self._holes.pop((client, up), None)
        kept = deque(each for each in self._required if each[2] != client)
        self.counts[RelayCounter.UNWATCHED] += len(self._required) - len(kept)
        self._required = kept
        return True

    def _write_waiting(self) -> bool:
        waiting, self._required = self._required, deque()
        unwatched = self.counts[RelayCounter.UNWATCHED]
        while waiting:
            if not self._write_or_count(waiting[0]):
                # `_write_or_count` has counted the record as lost, but the record still waits
                self.counts[RelayCounter.UNWATCHED] = unwatched
                break
            waiting.popleft()
        self._required = waiting
        return not waiting


class RingReader(_Ring):
    """One of the watcher's two readers of the ring. `position` counts the bytes that this reader has read."""

    def __init__(self, memory: memoryview, *, ahead: bool = False) -> None:
        """Read from the beginning. With `ahead`, records stay in the ring after this reader has read them."""
        super().__init__(memory)
        self.position = self._ready = 0
        self._position_field = _AHEAD if ahead else _READ

    @property
    def bytes_waiting(self) -> int:
        return self.bytes_written - self.position

    def read_records(self, limit: int = 8192, until: int | None = None) -> list[RingRecord]:
        """Return at most `limit` records. Without `until`, return only records that an earlier call of this
        method saw in the ring, because newer records may be incomplete. With `until`, return the records
        before this position. Pass the `position` of the watcher's other reader, which has already read
        these records.
        """
        records: list[RingRecord] = []
        space, size, read = self._space, self._size, self.position
        ready = self._ready if until is None else until
        new, head = tuple.__new__, _HEAD.unpack_from
        while read < ready and len(records) < limit:
            place = read % size
            need, kind, up, noted, client, length, received_at, sent_at = head(space, place)
            read += need
            end = place + 32 + length
            data = bytes(space[place + 32 : end])
            note = bytes(space[end : end + noted]) if noted else b""
            records.append(new(RingRecord, (_KINDS[kind], up == 1, client, received_at, sent_at, data, note)))
        self.position = read
        self._marks[self._position_field] = read
        if read >= self._ready:
            self._ready = self._marks[_WRITTEN]
        return records
