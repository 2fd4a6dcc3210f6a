"""Calls on disk, stored beside their observations."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple, cast

import msgspec

from bcapscope.capture.append_log import AppendLogReader, AppendLogWriter, CachedFileReader, write_all
from bcapscope.capture.observation_store import ObservationStore, decode_text, encode_text
from bcapscope.protocol.tables.function_table import ObjectClass, signed_function_id
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
from bcapscope.traffic.joining.joined_observation import JoinedObservation, join_sightings
from bcapscope.traffic.observation import Conversation, Flow
from bcapscope.traffic.reserved_field import ReservedFieldUsage

_CALLS, _ROW_BY_FRAME = "calls", "links"
_ROW_NUMBER = struct.Struct("<I")

_STATE_FIELDS = (
    "last_activity",
    "abandoned_at",
    "no_reply_expected",
    "skipped_handles",
    "gave_up_inferred",
    "reply_missed",
    "crossing_ns",
    "may_go_on",
    "sure_until",
    "is_at_controller",
    "was_overtaken",
)
"""Attributes of `Call` that `_Record.state` stores without conversion."""

_state_of = attrgetter(*_STATE_FIELDS)

_ObjectRecord = tuple[ObjectClass, int, bytes, bytes, int, bool]
_JoinedRecord = tuple[int, int, int, bool, bool, bytes]
"""A frame captured at two places: its number, the numbers of its sightings at the client's and at the
controller's side (0 if there is none), `is_missed`, `is_relayed`, `note`.
"""


class _Record(msgspec.Struct, array_like=True):
    """Stored form of a call or a stray reply. A record refers to frames by their observation numbers.

    For a stray reply, `number` is 0, and `request` is the reply's frame. `reply` is then the number of the
    call for which the reply is late, or 0. `evicted` means that the reply may belong to an evicted call.
    """

    number: int
    request: int
    reply: int = 0
    evicted: bool = False
    last_attempt: int = 0
    state: tuple[int | bool | None, ...] = ()
    unseen_serials: tuple[int, ...] = ()
    other_frames: list[tuple[FrameRole, int]] = []
    stray_replies: list[int] = []
    joined: list[_JoinedRecord] = []
    reserved_usage: ReservedFieldUsage = ReservedFieldUsage()
    subject: _ObjectRecord | None = None


_encode = msgspec.msgpack.encode
_decoder = msgspec.msgpack.Decoder(_Record)


class StoredCall(NamedTuple):
    """A complete call or a stray reply. `subject` is the object that the request addresses, if known."""

    settled: PairingResult
    subject: TrackedObject | None


class CallStoreWriter:
    """Writes each complete call or stray reply as a row. The file `_ROW_BY_FRAME` maps frames to rows."""

    def __init__(self, folder: Path) -> None:
        self._calls = AppendLogWriter(folder / _CALLS)
        self._file = (folder / _ROW_BY_FRAME).open("xb", buffering=0)
        # row of each frame that was added since the last flush; the key is the frame number
        self._new_rows: dict[int, int] = {}

    @property
    def count(self) -> int:
        return self._calls.count

    def add(self, settled: PairingResult, subject: TrackedObject | None) -> None:
        """Add a row. Before `flush`, the caller must write the frames of the row to the observation store."""
        if isinstance(settled, StrayReply):
            number = settled.observation.number
            late_for = settled.call_number or 0
            record = _Record(0, number, reply=late_for, evicted=settled.may_answer_evicted)
            frames = [number]
        else:
            record = _record_of(settled, subject)
            frames = [record.request, record.reply, *(number for _, number in record.other_frames)]
            frames += [number for _, near, far, *_ in record.joined for number in (near, far)]
        self._calls.add(_encode(record))
        self._new_rows.update((number, self._calls.count) for number in frames if number)

    def flush(self) -> None:
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
        thing = (subject.kind, subject.handle, name, parent, subject.created_by_call, subject.known_to_client)
    return _Record(
        call.number,
        call.request.number,
        0 if call.reply is None else call.reply.number,
        call.evicted,
        call.last_attempt.number,
        _state_of(call),
        call.unseen_serials,
        [(role, seen.number) for role, seen in call.other_frames],
        [seen.number for seen in call.stray_replies],
        [_joined_record(seen) for seen in call.joined_frames],
        call.reserved_usage,
        thing,
    )


def _joined_record(seen: JoinedObservation) -> _JoinedRecord:
    near, far = (0 if each is None else each.number for each in (seen.at_client, seen.at_controller))
    return seen.number, near, far, seen.is_missed, seen.is_relayed, encode_text(seen.note)


class CallStore:
    def __init__(self, folder: Path, observations: ObservationStore) -> None:
        self._observations = observations
        self._records = AppendLogReader(folder / _CALLS)
        self._row_by_frame = CachedFileReader(folder / _ROW_BY_FRAME)

    def __len__(self) -> int:
        return len(self._records)

    def refresh(self) -> int:
        self._row_by_frame.discard_cache()
        return self._records.refresh()

    def read_call(self, index: int) -> StoredCall:
        """Read a row by its index, from 0, or raise IndexError. Calls are in order of completion."""
        record = _decoder.decode(self._records.read_record(index))
        annotated = self._observations.read_frame(record.request)
        request = cast(FrameObservation, annotated.observation)
        if not record.number:
            return StoredCall(StrayReply(request, record.reply or None, record.evicted), None)
        kind = annotated.call_kind or CallKind(signed_function_id(request.item.code), None)
        frames = {record.request: request, **self._joined_frames(record, request.flow.conversation)}
        request = frames[record.request]
        call = Call(record.number, request.flow.conversation, kind, request, record.reserved_usage)
        call.last_attempt = self._read_frame(record.last_attempt, frames)
        call.reply = self._read_frame(record.reply, frames) if record.reply else None
        call.other_frames = [
            CallFrame(role, self._read_frame(number, frames)) for role, number in record.other_frames
        ]
        call.stray_replies = tuple(self._read_frame(number, frames) for number in record.stray_replies)
        for name, value in zip(_STATE_FIELDS, record.state, strict=True):
            setattr(call, name, value)
        call.unseen_serials = record.unseen_serials
        call.state = CallState.EVICTED if record.evicted else CallState.SETTLED
        return StoredCall(call, None if record.subject is None else _object_from_record(record.subject))

    def _joined_frames(self, record: _Record, conversation: Conversation) -> dict[int, FrameObservation]:
        frames: dict[int, FrameObservation] = {}
        for number, near, far, is_missed, is_relayed, note in record.joined:
            direction = self._observations.read_frame(number).observation.flow.direction
            at_client, at_controller = (
                self._observations.read_frame(each).observation if each else None for each in (near, far)
            )
            if at_controller is not None and is_relayed:
                conversation.controller_leg = at_controller.flow.conversation
            joined = join_sightings(
                at_client,
                at_controller,
                Flow(conversation, direction),
                is_missed=is_missed,
                is_relayed=is_relayed,
                note=decode_text(note),
            )
            frames[number] = cast(FrameObservation, joined)
        return frames

    def index_of_frame(self, frame: int) -> int | None:
        """Return the index of the row to which a frame belongs; None if no stored row has the frame."""
        data = self._row_by_frame.read((frame - 1) * _ROW_NUMBER.size, _ROW_NUMBER.size)
        row = int.from_bytes(data, "little")
        return row - 1 if row else None

    def _read_frame(self, number: int, known: Mapping[int, FrameObservation]) -> FrameObservation:
        if number in known:
            return known[number]
        return cast(FrameObservation, self._observations.read_frame(number).observation)

    def close(self) -> None:
        self._records.close()
        self._row_by_frame.close()


def _object_from_record(record: _ObjectRecord) -> TrackedObject:
    kind, handle, name, parent, created, known = record
    return TrackedObject(kind, handle, decode_text(name), decode_text(parent), created, known)
