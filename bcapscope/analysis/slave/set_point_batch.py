"""Set points that wait to be processed together, stored in little memory."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call

LARGE_FRAME = 2048
"""A frame with more bytes than this is stored separately. A set point has about a tenth of this size."""

LATEST_TIME = (1 << 62) - 1
"""Latest time that can be stored, in ns since 1970: in the year 2116. With this limit, the difference of any
two times fits into 64 bits. Only a damaged capture contains later times, which are stored as `LATEST_TIME`.
"""

_SERIAL = slice(5, 7)


class FrameBytes:
    """The frames of a batch in one direction, stored one after another.

    Attributes:
        size: Size in bytes of each frame in `data`; 0 until the first frame is added to `data`.
        data: All frames of this size, with zeros in place of frames of another size.
    """

    def __init__(self, raws: Iterable[bytes] = ()) -> None:
        self.size = 0
        self.data = bytearray()
        self.odd_sized: dict[int, bytes] = {}
        for place, raw in enumerate(raws):
            self.add(place, raw)

    def add(self, index: int, raw: bytes) -> None:
        if not self.size and 0 < len(raw) <= LARGE_FRAME:
            self.size = len(raw)
            self.data += bytes(self.size * index)
        if raw and len(raw) == self.size:
            self.data += raw
        else:
            self.odd_sized[index] = raw
            self.data += bytes(self.size)

    def __getitem__(self, index: int) -> bytes:
        found = self.odd_sized.get(index)
        return bytes(self.data[index * self.size : (index + 1) * self.size]) if found is None else found

    def serials(self, count: int) -> NDArray[np.int64]:
        """Return the serials of `count` frames; 0 for a missing frame."""
        found = np.zeros(count, np.int64)
        if self.size >= _SERIAL.stop:
            rows = np.frombuffer(self.data, np.uint8).reshape(-1, self.size)
            found[: len(rows)] = np.ascontiguousarray(rows[:, _SERIAL]).view("<u2")[:, 0]
        for index, raw in self.odd_sized.items():
            found[index] = int.from_bytes(raw[_SERIAL], "little")
        return found

    def clear(self) -> None:
        self.data = bytearray()
        self.odd_sized = {}


class SetPointRow(NamedTuple):
    """A set point, with times in ns since 1970. Without a reply, `reply_time` equals `time`."""

    call: int
    frame: int
    time: int
    reply_frame: int
    reply_time: int


_ROW = Struct("=5q")
_pack = _ROW.pack


class SetPointBatch:
    """Set points in the order in which they were sent.

    Attributes:
        row_data: The `SetPointRow` of each set point, as 64-bit integers.
        irregular: Index and call of each set point that was retried, was not answered with S_OK, or has a
            frame of unusual size.
        other_attempts: Number of attempts of the client's other calls since the previous set point. The key
            is the index of a set point. If the number is 0, there is no key.
    """

    def __init__(self) -> None:
        self.row_data = bytearray()
        self.other_attempts: dict[int, int] = {}
        self._attempts_since = 0  # number of attempts of other calls since the last set point
        self.requests, self.results = FrameBytes(), FrameBytes()
        self.irregular: list[tuple[int, Call]] = []

    def __len__(self) -> int:
        return len(self.row_data) // _ROW.size

    def __getitem__(self, index: int) -> SetPointRow:
        start = (index if index >= 0 else len(self) + index) * _ROW.size
        return SetPointRow(*_ROW.unpack_from(self.row_data, start))

    def add_other_call(self, call: Call) -> None:
        self._attempts_since += len(call.attempts)

    def _note_other_attempts(self) -> None:
        if self._attempts_since:
            self.other_attempts[len(self)] = self._attempts_since
            self._attempts_since = 0

    def add(self, call: Call) -> None:
        self._note_other_attempts()
        if call.is_plain and call.hresult == 0:
            self.add_run((call,))
        else:
            self._add_irregular(call)

    def add_run(self, calls: Sequence[Call]) -> None:
        """Add alike set points. Each set point was sent once, was answered with S_OK and has small frames."""
        self._note_other_attempts()
        requests, results, row_data = self.requests, self.results, self.row_data
        for call in calls:
            frame: int
            time: int
            reply_frame: int
            replied: int
            item: Frame
            result: Frame
            # Unpacking is faster than reading the attributes one by one.
            frame, time, _, _, item, _ = call.request  # type: ignore[misc]  # the value is a tuple
            reply_frame, replied, _, _, result, _ = call.reply  # type: ignore[misc]  # the value is a tuple
            raw, answer = item.raw, result.raw
            if len(raw) != requests.size or len(answer) != results.size:
                self._add_irregular(call)
                continue
            try:
                row_data += _pack(call.number, frame, time, reply_frame, replied)
            except struct.error:  # a time beyond 64 bits
                self._add_irregular(call)
                continue
            requests.data += raw
            results.data += answer

    def _add_irregular(self, call: Call) -> None:
        place, request, reply = len(self), call.request, call.reply
        self.irregular.append((place, call))
        self.requests.add(place, request.item.raw)
        self.results.add(place, b"" if reply is None else reply.item.raw)
        sent = _clip_time(request.time)
        replied = sent if reply is None else _clip_time(reply.time)
        self.row_data += _pack(
            call.number, request.number, sent, 0 if reply is None else reply.number, replied
        )

    def columns(self) -> NDArray[np.int64]:
        rows = np.frombuffer(self.row_data, np.int64).reshape(-1, len(SetPointRow._fields))
        return rows.T.copy()

    def clear(self) -> None:
        """Remove all set points. Arrays that `columns` has returned stay valid."""
        self.row_data = bytearray()
        self.other_attempts.clear()
        self.requests.clear()
        self.results.clear()
        self.irregular.clear()


def _clip_time(time: int) -> int:
    return min(max(time, -LATEST_TIME), LATEST_TIME)
