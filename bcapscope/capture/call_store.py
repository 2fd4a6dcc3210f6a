"""Calls on disk, stored beside their observations."""

from __future__ import annotations

import struct
from itertools import groupby
from pathlib import Path
from typing import NamedTuple, cast

import msgspec

from bcapscope.capture.append_log import AppendLogReader, AppendLogWriter, CachedFileReader, write_all
from bcapscope.capture.observation_store import ObservationStore, decode_text, encode_text
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.traffic.call import (
    Call,
    CallFrame,
    CallState,
    FrameObservation,
    FrameRole,
    PairingResult,
    StrayReply,
)
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedConvention, ReservedFieldUsage

_CALLS, _ROW_BY_FRAME = "calls", "links"
_ROW_NUMBER = _SIZE = struct.Struct("<I")
_ROLES = tuple(FrameRole)
_CONVENTIONS = tuple(ReservedConvention)
_RESERVED = tuple(ReplyReserved)
_CLASSES = tuple(ObjectClass)

_ObjectRecord = tuple[int, int, bytes, bytes, int, bool]


class _Record(msgspec.Struct, array_like=True):
    """Stored form of a call or a stray reply, which refers to frames by their observation numbers.

    For a stray reply, `number` is 0 and `request` is the number of the reply's frame. `reply` is the number
    of the call that the reply is too late for, or 0. `evicted` holds `may_answer_evicted`.
    """

    number: int
    request: int
    last_attempt: int = 0
    reply: int = 0
    other_frames: list[tuple[int, int]] = []
    last_activity: int = 0
    abandoned_at: int = 0
    no_reply_expected: bool = False
    evicted: bool = False
    skipped_handles: int = 0
    convention: int = 0
    reply_reserved: int = 0
    subject: _ObjectRecord | None = None
    unseen_serials: tuple[int, ...] = ()
    gave_up_inferred: bool = False
    reply_missed: bool = False
    crossing_ns: int = 0
    is_guess: bool = False


_encode = msgspec.msgpack.encode
_decoder = msgspec.msgpack.Decoder(_Record)


class StoredCall(NamedTuple):
    """A call or a stray reply.

    Attributes:
        settled: The complete call, or the stray reply.
        subject: The controller object that the request addresses; None if unknown.
    """

    settled: PairingResult
    subject: TrackedObject | None


class CallStoreWriter:
    """Writes each complete call or stray reply as a row, and saves which row each frame belongs to."""

    def __init__(self, folder: Path) -> None:
        """Create the files in the folder of an observation store."""
        self._calls = AppendLogWriter(folder / _CALLS)
        self._file = (folder / _ROW_BY_FRAME).open("xb", buffering=0)
        self._new_rows: dict[int, int] = {}  # row by frame number, added since the last flush

    @property
    def count(self) -> int:
        return self._calls.count

    def add(self, settled: PairingResult, subject: TrackedObject | None) -> None:
        """Add a call or stray reply as a row.

        Before `flush`, the caller must write the row's frames to the observation store.
        """
        if isinstance(settled, StrayReply):
            number = settled.observation.number
            late_for = settled.call_number or 0
            record = _Record(0, number, reply=late_for, evicted=settled.may_answer_evicted)
            frames = [number]
        else:
            record = _record_of(settled, subject)
            frames = [record.request, record.reply, *(number for _, number in record.other_frames)]
        data = _encode(record)
        self._calls.add(_SIZE.pack(len(data)) + data)
        self._new_rows.update((number, self._calls.count) for number in frames if number)

    def flush(self) -> None:
        """Make all added rows visible to readers.

        Raises:
            OSError: The files cannot be written, such as on a full disk.
        """
        self._calls.flush()
        frames = sorted(self._new_rows)
        for _, run in groupby(enumerate(frames), lambda each: each[1] - each[0]):  # frames without a gap
            numbers = [number for _, number in run]
            self._file.seek((numbers[0] - 1) * _ROW_NUMBER.size)
            write_all(self._file, b"".join(_ROW_NUMBER.pack(self._new_rows[number]) for number in numbers))
        self._new_rows.clear()

    def close(self) -> None:
        self._calls.close()
        self._file.close()


def _record_of(call: Call, subject: TrackedObject | None) -> _Record:
    thing: _ObjectRecord | None = None
    if subject is not None:
        name, parent = encode_text(subject.name), encode_text(subject.parent)
        kind = _CLASSES.index(subject.kind)
        thing = (kind, subject.handle, name, parent, subject.created_by_call, subject.known_to_client)
    return _Record(
        call.number,
        call.request.number,
        call.last_attempt.number,
        0 if call.reply is None else call.reply.number,
        [(_ROLES.index(role), seen.number) for role, seen in call.other_frames],
        call.last_activity,
        call.abandoned_at,
        call.no_reply_expected,
        call.evicted,
        call.skipped_handles,
        _CONVENTIONS.index(call.reserved_usage.convention),
        _RESERVED.index(call.reserved_usage.reply_reserved),
        thing,
        call.unseen_serials,
        call.gave_up_inferred,
        call.reply_missed,
        call.crossing_ns,
        call.is_guess,
    )


class CallStore:
    """Reads the files of a `CallStoreWriter`, even while the writer adds rows."""

    def __init__(self, folder: Path, observations: ObservationStore) -> None:
        """Open the files of a `CallStoreWriter` in a folder.

        Raises: OSError: The folder holds no files of a `CallStoreWriter`.
        """
        self._observations = observations
        self._records = AppendLogReader(folder / _CALLS)
        self._row_by_frame = CachedFileReader(folder / _ROW_BY_FRAME)

    def __len__(self) -> int:
        return len(self._records)

    def refresh(self) -> int:
        self._row_by_frame.discard_cache()
        return self._records.refresh()

    def read_call(self, index: int) -> StoredCall:
        """Read a row by its index from 0. The rows are in the order in which the calls became complete.

        Raises: IndexError: No row has this index.
        """
        record = _decoder.decode(self._read_record(index))
        annotated = self._observations.read_frame(record.request)
        request = cast(FrameObservation, annotated.observation)
        if not record.number:
            return StoredCall(StrayReply(request, record.reply or None, record.evicted), None)
        kind = annotated.call_kind or CallKind(request.item.code, None)
        usage = ReservedFieldUsage(_CONVENTIONS[record.convention], _RESERVED[record.reply_reserved])
        call = Call(record.number, request.flow.conversation, kind, request, usage)
        call.last_attempt = self._read_frame(record.last_attempt, request)
        call.reply = self._read_frame(record.reply, request) if record.reply else None
        call.other_frames = [
            CallFrame(_ROLES[role], self._read_frame(number, request)) for role, number in record.other_frames
        ]
        call.last_activity, call.abandoned_at = record.last_activity, record.abandoned_at
        call.no_reply_expected, call.skipped_handles = record.no_reply_expected, record.skipped_handles
        call.unseen_serials, call.gave_up_inferred = record.unseen_serials, record.gave_up_inferred
        call.reply_missed, call.crossing_ns = record.reply_missed, record.crossing_ns
        call.is_guess = record.is_guess
        call.state = CallState.EVICTED if record.evicted else CallState.SETTLED
        return StoredCall(call, None if record.subject is None else _object_from_record(record.subject))

    def index_of_frame(self, frame: int) -> int | None:
        """Return the index of the row to which a frame belongs; None if no stored row has the frame."""
        data = self._row_by_frame.read((frame - 1) * _ROW_NUMBER.size, _ROW_NUMBER.size)
        row = int.from_bytes(data, "little")
        return row - 1 if row else None

    def _read_frame(self, number: int, request: FrameObservation) -> FrameObservation:
        if number == request.number:
            return request
        return cast(FrameObservation, self._observations.read_frame(number).observation)

    def _read_record(self, index: int) -> bytes:
        start = self._records.offset_of(index)
        (size,) = _SIZE.unpack(self._records.read(start, _SIZE.size))
        return self._records.read(start + _SIZE.size, size)

    def close(self) -> None:
        self._records.close()
        self._row_by_frame.close()


def _object_from_record(record: _ObjectRecord) -> TrackedObject:
    kind, handle, name, parent, created, known = record
    return TrackedObject(_CLASSES[kind], handle, decode_text(name), decode_text(parent), created, known)
