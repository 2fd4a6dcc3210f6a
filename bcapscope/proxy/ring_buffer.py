"""A ring in shared memory, through which the relay passes its traffic to the watcher.

A write costs the relay about a microsecond and no system call, and never waits. Records without room are
counted. There is one writer and one reader. The reader reads what was written before its previous poll, so
that the order in which processors store data does not matter.
"""

from __future__ import annotations

import struct
from collections import deque
from enum import IntEnum
from typing import NamedTuple, TypeAlias

from bcapscope.transport.receive_timestamps import AncillaryData, kernel_timestamp

HEADER_SIZE = 4096
"""Bytes before the records: the positions of writer and reader, and the counts."""

SET_POINT_DEADLINE_NS = 2_000_000
"""ns within which a set point must be answered (DENSO Wave 2009, How to use the Slave mode)."""

BATCH_SIZE = 16
"""Datagrams that are collected before they are written together. Other datagrams may wait during a write."""

DELAY_FIGURES = 9
"""Figures that the watcher leaves for the relay: the fields of `control_messages.RelayDelays`, in order."""

MAX_WAITING_NOTICES = 1024
"""Messages for the user that may wait for room. Further ones are lost and counted."""

_HEAD = struct.Struct("=IBBHIIqq")
_PAD = struct.Struct("=IB3x")
_HOLE = struct.Struct("=QQ")
_WRITTEN, _READ, _AHEAD, _URGENCY, _COUNTS, _FIGURES = 0, 1, 2, 3, 8, 64  # header indices, 8 bytes each
_PADDING = tuple(bytes(-length % 8) for length in range(8))


class RingRecordKind(IntEnum):
    """What a record describes."""

    PAD = 0
    """Nothing: the rest of the memory is too small for the next record."""
    DATA = 1
    """A datagram or bytes of a stream that were received, sent, or both."""
    CLIENT_OPENED = 2
    """A new client; `data` is JSON."""
    END = 3
    """A FIN for one direction of a stream, received or sent. `data` is the reason if none was received."""
    CLIENT_CLOSED = 4
    """A client was removed; `data` is the reason."""
    NOTICE = 5
    """A message for the user, as text."""
    RESET = 6
    """Like `END`, but by RST, which ends the other direction as well."""
    HOLE = 7
    """Bytes of a stream that found no room, before the client's next record.
    `hole_sizes` returns how many.
    """


class RelayCounter(IntEnum):
    """What the relay counts."""

    CAME_UP = 0
    """Datagrams received from clients."""
    LEFT_UP = 1
    """Datagrams sent to controllers."""
    CAME_DOWN = 2
    LEFT_DOWN = 3
    BYTES_UP = 4
    """Bytes of streams sent to controllers."""
    BYTES_DOWN = 5
    FULL = 6
    """Datagrams that the system refused to send."""
    LOST = 7
    """Datagrams that found no room in a socket's buffer."""
    DENIED = 8
    """Datagrams and connections of clients that are not allowed, or too many."""
    CLIENTS = 9
    """Clients since the start."""
    UNWATCHED = 10
    """Records that found no room in the ring."""
    RULED = 11
    """Datagrams and pieces of streams that a rule touched."""


_CAME, _LEFT = (
    (int(RelayCounter.CAME_DOWN), int(RelayCounter.CAME_UP)),
    (int(RelayCounter.LEFT_DOWN), int(RelayCounter.LEFT_UP)),
)
_DATA = int(RingRecordKind.DATA)
_KINDS = tuple(RingRecordKind)


class RingRecord(NamedTuple):
    """One event in the relay.

    Attributes:
        kind: Kind of event.
        up: True from client to controller, False from controller to client.
        client: Number of the client; 0 if the event concerns none.
        received_at: Time of receipt or of the event, ns since 1970; 0 for data that was only sent.
        sent_at: Time just before sending, ns since 1970, so that no reply is older; 0 if not sent, or not
            yet.
        data: Data; its meaning depends on `kind`.
        note: What a rule did, as of `encode_message`; b"" for nothing.
    """

    kind: RingRecordKind
    up: bool
    client: int
    received_at: int
    sent_at: int
    data: bytes
    note: bytes


def hole_sizes(record: RingRecord) -> tuple[int, int]:
    """Return how many bytes a record of the kind `HOLE` stands for: bytes received, bytes sent."""
    came, left = _HOLE.unpack(record.data)
    return came, left


class _Hole(NamedTuple):
    """Bytes of one direction of a stream that found no room: how many, and when the last were; 0 for none."""

    received: int = 0
    sent: int = 0
    received_at: int = 0
    sent_at: int = 0


class _Ring:
    def __init__(self, memory: memoryview) -> None:
        """Use shared memory of `HEADER_SIZE` bytes plus a multiple of 8 bytes, initially zero."""
        self._marks = memory[:HEADER_SIZE].cast("Q")
        self._space = memory[HEADER_SIZE:]
        self._size = len(self._space)
        self.counts = self._marks[_COUNTS : _COUNTS + len(RelayCounter)]
        self.figures = self._marks[_FIGURES : _FIGURES + DELAY_FIGURES]

    @property
    def bytes_written(self) -> int:
        return self._marks[_WRITTEN]

    @property
    def fill_ratio(self) -> float:
        """Occupied share of the memory, 0 to 1."""
        return (self._marks[_WRITTEN] - self._marks[_READ]) / self._size

    @property
    def urgency(self) -> int:
        """Urgency that the writer asks of the reader, as a number that both know."""
        return self._marks[_URGENCY]

    @urgency.setter
    def urgency(self, value: int) -> None:
        self._marks[_URGENCY] = value

    def release(self) -> None:
        self.counts.release()
        self.figures.release()
        self._marks.release()
        self._space.release()


_Entry: TypeAlias = "tuple[RingRecordKind, bool, int, int, int, bytes | memoryview, bytes]"
"""A record to be written: the fields of a `RingRecord`."""

PendingDatagram: TypeAlias = tuple[bool, int, AncillaryData, int, bytes]
"""A datagram: up, client, ancillary data from the system, time of sending (0 if not sent), bytes."""


class RingWriter(_Ring):
    """The relay's end of the ring.

    Attributes:
        counts: Counts of the relay, indexed by `RelayCounter`; add to them in place.
        figures: Figures of the watcher; see `DELAY_FIGURES`.
        pending_datagrams: Datagrams not written yet. A caller that appends one calls `flush` at `BATCH_SIZE`.
        streams: Numbers of the clients whose bytes are streams, in which holes must be recorded.
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
        """Write and count the pending datagrams."""
        notes = self.pending_datagrams
        if not notes:
            return
        counts, size = self.counts, 0
        parts: list[bytes] = []
        for up, client, control, left, data in notes:
            length = len(data)
            need = 39 + length & ~7
            size += need
            came = kernel_timestamp(control, left)
            parts += (_HEAD.pack(need, _DATA, up, 0, client, length, came, left), data, _PADDING[length & 7])
            counts[_CAME[up]] += 1
            if left:
                counts[_LEFT[up]] += 1
        written = self._written
        place = written % self._size
        if self._required or place + size > self._size or written + size - self._marks[_READ] > self._size:
            for up, client, control, left, data in notes:
                self._write_or_count(
                    (RingRecordKind.DATA, up, client, kernel_timestamp(control, left), left, data, b"")
                )
        else:
            self._space[place : place + size] = b"".join(parts)
            self._marks[_WRITTEN] = self._written = written + size
        notes.clear()

    @property
    def bytes_read(self) -> int:
        """Bytes read so far, by the reader that is ahead if there is one."""
        return max(self._marks[_READ], self._marks[_AHEAD])

    def detach_reader(self) -> None:
        """Continue without a reader."""
        self._is_reader_detached = True
        self._required.clear()
        self._holes.clear()

    def write_record(
        self,
        up: bool,
        client: int,
        received_at: int,
        sent_at: int,
        data: bytes | memoryview,
        *,
        note: bytes = b"",
        kind: RingRecordKind = RingRecordKind.DATA,
    ) -> bool:
        """Write a record, or count it as unwatched. Return whether there was room."""
        self.flush()
        return self._write_or_count((kind, up, client, received_at, sent_at, data, note))

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
        """Count a record that found no room, and remember the hole that it leaves in a stream."""
        kind, up, client, came, left, data, _ = entry
        self.counts[RelayCounter.UNWATCHED] += 1
        if kind is RingRecordKind.DATA and client in self.streams and not self._is_reader_detached:
            hole, size = self._holes.get((client, up), _Hole()), len(data)
            self._holes[client, up] = _Hole(
                hole.received + (size if came else 0),
                hole.sent + (size if left else 0),
                came or hole.received_at,
                left or hole.sent_at,
            )

    def _write_holes(self, client: int, size: int) -> bool:
        """Write the holes of a client's streams. Return whether there was room for them and the next record.

        Without room for both there would be many short holes instead of one long hole.
        """
        holes = [(up, hole) for up in (True, False) if (hole := self._holes.get((client, up)))]
        if not holes:
            return True
        needed = size + _HEAD.size + len(holes) * (_HEAD.size + _HOLE.size)
        if self._written + 2 * needed - self._marks[_READ] > self._size:  # twice, to allow for padding
            return False
        for up, hole in holes:
            data = _HOLE.pack(hole.received, hole.sent)
            self._write((RingRecordKind.HOLE, up, client, hole.received_at, hole.sent_at, data, b""))
            del self._holes[client, up]
        return True

    def _write(self, entry: _Entry) -> bool:
        """Write a record. Return whether there was room for it."""
        kind, up, client, came, left, data, note = entry
        length = len(data)
        need = 39 + length + len(note) & ~7
        size, written = self._size, self._written
        place = written % size
        rest = size - place
        pad = rest if need > rest else 0
        if written + pad + need - self._marks[_READ] > size:
            return False
        space = self._space
        if pad:
            _PAD.pack_into(space, place, pad, RingRecordKind.PAD)
            written += pad
            place = 0
        _HEAD.pack_into(space, place, need, kind, up, len(note), client, length, came, left)
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
        """Write a record that must not be lost, now or as soon as there is room. All other records wait for
        it.

        The waiting records are bounded even if the reader stands still. A client that opens and closes
        meanwhile is left out, and excess notices are lost.
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
        """Discard the waiting records of a client unknown to the reader. Return whether it was unknown."""
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
                self.counts[RelayCounter.UNWATCHED] = unwatched  # it still waits and is not lost
                break
            waiting.popleft()
        self._required = waiting
        return not waiting


class RingReader(_Ring):
    """The watcher's end of the ring, or a reader ahead of it.

    Attributes:
        counts: Counts of the relay, indexed by `RelayCounter`.
        figures: Figures of the watcher; see `DELAY_FIGURES`.
        position: Bytes read so far.
    """

    def __init__(self, memory: memoryview, *, ahead: bool = False) -> None:
        """Read from the beginning.

        Args:
            memory: Memory shared with the writer.
            ahead: True if another reader follows. Only what the other one has read is freed.
        """
        super().__init__(memory)
        self.position = self._ready = 0
        self._position_field = _AHEAD if ahead else _READ

    @property
    def bytes_waiting(self) -> int:
        """Bytes written and not read yet."""
        return self.bytes_written - self.position

    def read_records(self, limit: int = 8192, until: int | None = None) -> list[RingRecord]:
        """Return records that were written before the previous call, and note what is written now.

        Args:
            limit: Highest number of records.
            until: Position of the reader that is ahead; nothing beyond it is returned. None without one.
        """
        records: list[RingRecord] = []
        space, size, read = self._space, self._size, self.position
        ready = self._ready if until is None else until
        whole = size - _HEAD.size
        new, head = tuple.__new__, _HEAD.unpack_from
        while read < ready and len(records) < limit:
            place = read % size
            if place > whole:  # padding whose header does not fit before the end of the memory
                read += size - place
                continue
            need, kind, up, noted, client, length, came, left = head(space, place)
            read += need
            if kind:
                end = place + 32 + length
                data = bytes(space[place + 32 : end])
                note = bytes(space[end : end + noted]) if noted else b""
                records.append(new(RingRecord, (_KINDS[kind], up == 1, client, came, left, data, note)))
        self.position = read
        self._marks[self._position_field] = read
        if read >= self._ready:
            self._ready = self._marks[_WRITTEN]
        return records
