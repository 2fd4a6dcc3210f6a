"""Calls kept on disk beside the observations that they are made of."""

from __future__ import annotations

import struct
from array import array
from pathlib import Path
from typing import NamedTuple, cast

import msgspec

from bcapscope.capture.journal import Journal, to_bytes, to_text
from bcapscope.capture.spool import Appender, Records, Window
from bcapscope.protocol.functions import ObjectClass
from bcapscope.traffic.convention import Convention, Habits, ReplyReserved
from bcapscope.traffic.exchange import Event, Exchange, FrameObservation, Role, Settled, Stray
from bcapscope.traffic.handles import Thing
from bcapscope.traffic.question import Question

_CALLS, _LINKS = "calls", "links"
_LINK = _SIZE = struct.Struct("<I")
_ROLES = tuple(Role)
_CONVENTIONS = tuple(Convention)
_RESERVED = tuple(ReplyReserved)
_CLASSES = tuple(ObjectClass)

_ThingRecord = tuple[int, int, bytes, bytes, int, bool]
_Record = tuple[
    int, int, int, int, list[tuple[int, int]], int, int, bool, bool, int, int, int, _ThingRecord | None
]
"""Call, request, last try, reply or 0, roles and frames of the others, activity, gone on, silent, let go,
skipped handles, convention and reserved of the replies, the object. Of a stray: 0, its frame, 0, the call it
is too late for or 0, whether it was overlooked in the place of let go, and nothing else."""

_encode = msgspec.msgpack.encode
_decoder = msgspec.msgpack.Decoder(_Record)


class Row(NamedTuple):
    """A call, or a reply that belongs to none, with the object that it was asked of where that is known."""

    settled: Settled
    subject: Thing | None


class CallbookWriter:
    """Writes calls as they settle, and which frames belong to which."""

    def __init__(self, folder: Path) -> None:
        """Begin in the folder of a journal."""
        self._calls = Appender(folder / _CALLS)
        self._file = (folder / _LINKS).open("xb", buffering=0)
        self._links = array("I")
        self._first_new = 0

    @property
    def count(self) -> int:
        """Rows so far."""
        return self._calls.count

    def add(self, settled: Settled, subject: Thing | None) -> None:
        """Note a call; its frames are in the journal before `flush`."""
        if isinstance(settled, Stray):
            number = settled.seen.number
            overlooked = settled.overlooked
            record: _Record = (0, number, 0, settled.call or 0, [], 0, 0, False, overlooked, 0, 0, 0, None)
            frames = [number]
        else:
            record = _record(settled, subject)
            frames = [record[1], record[3], *(number for _, number in record[4])]
        data = _encode(record)
        self._calls.add(_SIZE.pack(len(data)) + data)
        for number in frames:
            if number:
                self._link(number, self._calls.count)

    def _link(self, number: int, row: int) -> None:
        links = self._links
        if number > len(links):
            links.extend([0] * (number + 1024 - len(links)))
        links[number - 1] = row
        self._first_new = min(self._first_new, number - 1)

    def flush(self) -> None:
        """Let readers see all that was added.

        Raises:
            OSError: there is no room.
        """
        self._calls.flush()
        if self._first_new < len(self._links):
            self._file.seek(self._first_new * _LINK.size)
            self._file.write(self._links[self._first_new :].tobytes())
        self._first_new = len(self._links)

    def close(self) -> None:
        """Close the files."""
        self._calls.close()
        self._file.close()


def _record(call: Exchange, subject: Thing | None) -> _Record:
    thing: _ThingRecord | None = None
    if subject is not None:
        name, parent = to_bytes(subject.name), to_bytes(subject.parent)
        kind = _CLASSES.index(subject.kind)
        thing = (kind, subject.handle, name, parent, subject.created, subject.known)
    return (
        call.call,
        call.request.number,
        call.last.number,
        0 if call.reply is None else call.reply.number,
        [(_ROLES.index(role), seen.number) for role, seen in call.others],
        call.activity,
        call.gone_on,
        call.silent,
        call.let_go,
        call.skipped_handles,
        _CONVENTIONS.index(call.habits.convention),
        _RESERVED.index(call.habits.replies),
        thing,
    )


class Callbook:
    """Reads what a `CallbookWriter` wrote, while it does."""

    def __init__(self, folder: Path, journal: Journal) -> None:
        """Open the calls of a folder.

        Raises:
            OSError: there are none.
        """
        self._journal = journal
        self._records = Records(folder / _CALLS)
        self._links = Window(folder / _LINKS)

    def __len__(self) -> int:
        """How many rows there were when `refresh` was called last."""
        return len(self._records)

    def refresh(self) -> int:
        """Look how many there are by now."""
        self._links.forget()
        return self._records.refresh()

    def row(self, index: int) -> Row:
        """Read a row by its index from 0, in the order in which calls settled.

        Raises:
            IndexError: there is none.
        """
        (
            call, request, last, reply, others, activity, gone_on, silent, let_go, skipped,
            convention, replies, thing,
        ) = _decoder.decode(self._read(index))  # fmt: skip
        told = self._journal.told(request)
        seen = cast(FrameObservation, told.seen)
        if not call:
            return Row(Stray(seen, reply or None, let_go), None)
        question = told.question or Question(seen.item.code, None)
        habits = Habits(_CONVENTIONS[convention], _RESERVED[replies])
        made = Exchange(call, seen.flow.conversation, question, seen, habits)
        made.last = self._frame(last, seen)
        made.reply = self._frame(reply, seen) if reply else None
        made.others = [Event(_ROLES[role], self._frame(number, seen)) for role, number in others]
        made.activity, made.gone_on = activity, gone_on
        made.silent, made.let_go, made.skipped_handles = silent, let_go, skipped
        return Row(made, None if thing is None else _thing(thing))

    def row_of(self, frame: int) -> int | None:
        """Tell which row a frame belongs to; None where that is not known, or not yet."""
        data = self._links.read((frame - 1) * _LINK.size, _LINK.size)
        row = int.from_bytes(data, "little")
        return row - 1 if row else None

    def _frame(self, number: int, request: FrameObservation) -> FrameObservation:
        if number == request.number:
            return request
        return cast(FrameObservation, self._journal.told(number).seen)

    def _read(self, index: int) -> bytes:
        start = self._records.place(index)
        (size,) = _SIZE.unpack(self._records.read(start, _SIZE.size))
        return self._records.read(start + _SIZE.size, size)

    def close(self) -> None:
        """Close the files."""
        self._records.close()
        self._links.close()


def _thing(record: _ThingRecord) -> Thing:
    kind, handle, name, parent, created, known = record
    return Thing(_CLASSES[kind], handle, to_text(name), to_text(parent), created, known)
