"""From the relay to whoever watches it: a ring in memory that both share.

Writing costs the relay about a microsecond, no system call, and never waits: what finds no room is counted.
There is one writer and one reader. The reader takes what was written by the time of its look before, so that
no processor's order of stores matters.
"""

from __future__ import annotations

import struct
from collections import deque
from enum import IntEnum
from typing import NamedTuple, TypeAlias

from bcapscope.transport.receive_timestamps import AncillaryData, kernel_timestamp

HEADER_SIZE = 4096
"""Bytes before the records: where writer and reader are, and the counts."""

SET_POINT_DEADLINE_NS = 2_000_000
"""ns in which a set point has to be answered (DENSO Wave 2009, How to use the Slave mode)."""

BATCH_SIZE = 16
"""Datagrams that are noted before they are written together: writing costs time in which others may wait."""

MAX_WAITING_NOTICES = 1024
"""Sentences that wait for room; those that come then are lost, and counted."""

_HEAD = struct.Struct("=IBBHIIqq")
_PAD = struct.Struct("=IB3x")
_HOLE = struct.Struct("=QQ")
_WRITTEN, _READ, _AHEAD, _URGENCY, _COUNTS, _FIGURES = 0, 1, 2, 3, 8, 64  # places in the header, in 8 bytes
_PADDING = tuple(bytes(-length % 8) for length in range(8))


class RingRecordKind(IntEnum):
    """What a record tells."""

    PAD = 0
    """Nothing: the rest of the memory is too small for the next one."""
    DATA = 1
    """A datagram or bytes of a stream: came, or left, or both."""
    CLIENT_OPENED = 2
    """A new client; `data` is JSON."""
    END = 3
    """A stream's direction has ended by FIN: it came, or left; `data` is why, where none had come."""
    CLIENT_CLOSED = 4
    """A client is forgotten; `data` is why."""
    NOTICE = 5
    """Something for the user, in words."""
    RESET = 6
    """As `END`, by RST, after which there is no other direction either."""
    HOLE = 7
    """Bytes of a stream that found no room, before what is told next of its client; how many: `hole_sizes`.
    """


class RelayCounter(IntEnum):
    """What the relay counts."""

    CAME_UP = 0
    """Datagrams from clients."""
    LEFT_UP = 1
    """Datagrams sent to controllers."""
    CAME_DOWN = 2
    LEFT_DOWN = 3
    BYTES_UP = 4
    """Of streams, sent to controllers."""
    BYTES_DOWN = 5
    FULL = 6
    """Datagrams that the system would not send."""
    LOST = 7
    """Datagrams that found no room in a socket's buffer."""
    DENIED = 8
    """Datagrams and connections of clients that are not allowed, or too many."""
    CLIENTS = 9
    """Clients, all in all."""
    UNWATCHED = 10
    """Records that found no room."""
    RULED = 11
    """Datagrams and pieces of streams that a rule touched."""


class DelayFigure(IntEnum):
    """What the watcher finds out and leaves for the relay to tell: how long it holds what passes, in ns."""

    P50_UP = 0
    P99_UP = 1
    P999_UP = 2
    MAX_UP = 3
    P50_DOWN = 4
    P99_DOWN = 5
    P999_DOWN = 6
    MAX_DOWN = 7
    SLOW = 8
    """How often it was longer than `SET_POINT_DEADLINE_NS`: times, not ns."""


_CAME, _LEFT = (
    (int(RelayCounter.CAME_DOWN), int(RelayCounter.CAME_UP)),
    (int(RelayCounter.LEFT_DOWN), int(RelayCounter.LEFT_UP)),
)
_DATA = int(RingRecordKind.DATA)
_KINDS = tuple(RingRecordKind)


class RingRecord(NamedTuple):
    """One thing that the relay did.

    Attributes:
        kind: what.
        up: from client to controller; else the other way.
        client: its number; 0 where it concerns none.
        received_at: ns since 1970 when it was received, or happened; 0 for data that were only sent.
        sent_at: ns since 1970 when it was about to be sent, so that no answer is older; 0 if it was not, or
            not yet.
        data: what.
        note: what a rule did.
    """

    kind: RingRecordKind
    up: bool
    client: int
    received_at: int
    sent_at: int
    data: bytes
    note: str


def hole_sizes(record: RingRecord) -> tuple[int, int]:
    """Return how many bytes a record of the kind `HOLE` stands for: of those that came, and that left."""
    came, left = _HOLE.unpack(record.data)
    return came, left


class _Hole:
    """What found no room of one direction of a stream.

    Attributes:
        received: bytes of what was received.
        sent: bytes of what was sent.
        received_at: when the last of them did, ns since 1970; 0 for none.
        sent_at: the same.
    """

    __slots__ = ("received", "received_at", "sent", "sent_at")

    def __init__(self) -> None:
        self.received = self.sent = self.received_at = self.sent_at = 0

    def add(self, received_at: int, sent_at: int, size: int) -> None:
        if received_at:
            self.received += size
            self.received_at = received_at
        if sent_at:
            self.sent += size
            self.sent_at = sent_at


class _Ring:
    def __init__(self, memory: memoryview) -> None:
        """Use memory that both ends share, zeros at first, of `HEADER_SIZE` and a multiple of 8 bytes."""
        self._marks = memory[:HEADER_SIZE].cast("Q")
        self._space = memory[HEADER_SIZE:]
        self._size = len(self._space)
        self.counts = self._marks[_COUNTS : _COUNTS + len(RelayCounter)]
        self.figures = self._marks[_FIGURES : _FIGURES + len(DelayFigure)]

    @property
    def bytes_written(self) -> int:
        """Bytes that were written so far."""
        return self._marks[_WRITTEN]

    @property
    def fill_ratio(self) -> float:
        """Share of the memory that no room is in, 0 to 1."""
        return (self._marks[_WRITTEN] - self._marks[_READ]) / self._size

    @property
    def urgency(self) -> int:
        """In what haste the reader is to be, as the writer says; both know the numbers."""
        return self._marks[_URGENCY]

    @urgency.setter
    def urgency(self, haste: int) -> None:
        self._marks[_URGENCY] = haste

    def release(self) -> None:
        """Let go of the memory."""
        self.counts.release()
        self.figures.release()
        self._marks.release()
        self._space.release()


_Entry: TypeAlias = "tuple[RingRecordKind, bool, int, int, int, bytes | memoryview, bytes]"
"""What is to be written: a `RingRecord` with its note still in bytes."""

PendingDatagram: TypeAlias = tuple[bool, int, AncillaryData, int, bytes]
"""A datagram: up, client, what the system said of it, when it had been sent (0 if it was not), bytes."""


class RingWriter(_Ring):
    """The relay's end.

    Attributes:
        counts: by `RelayCounter`; the relay's own, to be added to in place.
        figures: by `DelayFigure`; the watcher's.
        pending_datagrams: datagrams that are not written yet; whoever notes one looks whether they are
            `BATCH_SIZE`.
        streams: numbers of the clients whose bytes are streams, in which a hole has to be told.
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
        """Write and count what is noted."""
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
        """Bytes that were taken so far, by the reader that is ahead if there is one."""
        return max(self._marks[_READ], self._marks[_AHEAD])

    def detach_reader(self) -> None:
        """Go on without a reader."""
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
        """Write a record, or count it as unwatched; tell whether there was room."""
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
        """Count what found no room, and remember that a stream goes on behind it."""
        kind, up, client, came, left, data, _ = entry
        self.counts[RelayCounter.UNWATCHED] += 1
        if kind is RingRecordKind.DATA and client in self.streams and not self._is_reader_detached:
            self._holes.setdefault((client, up), _Hole()).add(came, left, len(data))

    def _write_holes(self, client: int, size: int) -> bool:
        """Tell what is missing of a client's streams; tell if there was room for that and for what follows.

        Without room for both there would be many short holes instead of one.
        """
        holes = [(up, hole) for up in (True, False) if (hole := self._holes.get((client, up)))]
        if not holes:
            return True
        needed = size + _HEAD.size + len(holes) * (_HEAD.size + _HOLE.size)
        if self._written + 2 * needed - self._marks[_READ] > self._size:  # twice, for what is padded
            return False
        for up, hole in holes:
            data = _HOLE.pack(hole.received, hole.sent)
            self._write((RingRecordKind.HOLE, up, client, hole.received_at, hole.sent_at, data, b""))
            del self._holes[client, up]
        return True

    def _write(self, entry: _Entry) -> bool:
        """Write a record, if there is room for it."""
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
        """Write what has to be known, now or as soon as there is room; everything else waits for it.

        Where the reader stands still, what waits is bounded all the same: a client that comes and goes
        meanwhile was never there, and not all is told.
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
        """Take back all that waits of a client that the reader has not met; tell whether that is so."""
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
        owed, self._required = self._required, deque()
        unwatched = self.counts[RelayCounter.UNWATCHED]
        while owed:
            if not self._write_or_count(owed[0]):
                self.counts[RelayCounter.UNWATCHED] = unwatched  # it is not given up
                break
            owed.popleft()
        self._required = owed
        return not owed


class RingReader(_Ring):
    """The watcher's end, or one that reads ahead of it.

    Attributes:
        counts: by `RelayCounter`; the relay's.
        figures: by `DelayFigure`; the watcher's own.
        position: bytes that were taken so far.
    """

    def __init__(self, memory: memoryview, *, ahead: bool = False) -> None:
        """Read from the beginning.

        Args:
            memory: that both ends share.
            ahead: another reader comes behind; only what that one has taken makes room.
        """
        super().__init__(memory)
        self.position = self._ready = 0
        self._position_field = _AHEAD if ahead else _READ

    @property
    def bytes_waiting(self) -> int:
        """Bytes that were written and not taken yet."""
        return self.bytes_written - self.position

    def read_records(self, limit: int = 8192, until: int | None = None) -> list[RingRecord]:
        """Return what had been written at the last look, so many records at most, and look again.

        Args:
            limit: records.
            until: what lies behind the `position` of a reader that is ahead is left to it; None for no other.
        """
        records: list[RingRecord] = []
        space, size, read = self._space, self._size, self.position
        ready = self._ready if until is None else until
        whole = size - _HEAD.size
        new, head = tuple.__new__, _HEAD.unpack_from
        while read < ready and len(records) < limit:
            place = read % size
            if place > whole:  # a pad whose head is cut by the end of the memory
                read += size - place
                continue
            need, kind, up, noted, client, length, came, left = head(space, place)
            read += need
            if kind:
                end = place + 32 + length
                data = bytes(space[place + 32 : end])
                note = str(space[end : end + noted], "utf-8", "replace") if noted else ""
                records.append(new(RingRecord, (_KINDS[kind], up == 1, client, came, left, data, note)))
        self.position = read
        self._marks[self._position_field] = read
        if read >= self._ready:
            self._ready = self._marks[_WRITTEN]
        return records
