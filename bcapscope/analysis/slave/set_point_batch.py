"""Set points that wait until many are looked at together, in as little memory as they take."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call import Call, FrameObservation

LARGE_FRAME = 2048
"""Bytes; a set point has a tenth. Larger ones are kept aside."""

LATEST_TIME = (1 << 62) - 1
"""Nanoseconds since 1970, in the year 2116: the difference of two times no further off fits 64 bits. What a
damaged capture claims beyond counts as this."""

HANDLE_VALUE_BYTES = slice(25, 29)
"""Where a request that is not compressed has the value of its first argument."""


class FrameBytes:
    """Frames of one direction, one behind the other.

    Attributes:
        size: of each in `data`; 0 as long as there is none.
        data: the frames, with zeros in the place of each that has another size.
        odd_sized: those, by place; b"" for one that is missing.
    """

    __slots__ = ("data", "odd_sized", "size")

    def __init__(self, raws: Iterable[bytes] = ()) -> None:
        self.size = 0
        self.data = bytearray()
        self.odd_sized: dict[int, bytes] = {}
        for place, raw in enumerate(raws):
            self.add(place, raw)

    def add(self, index: int, raw: bytes) -> None:
        """Add a frame behind `index` others; the first that is not large decides about the size of most."""
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

    def clear(self) -> None:
        """Forget all; the size of most is expected to stay."""
        self.data = bytearray()
        self.odd_sized = {}


class SetPointRow(NamedTuple):
    """What is kept of a set point besides its bytes.

    Attributes:
        call: its number.
        frame: of the first request.
        time: of that, nanoseconds since 1970-01-01 UTC.
        reply_frame: of the accepted reply; 0 where there is none.
        reply_time: time of that; that of the request where there is none.
    """

    call: int
    frame: int
    time: int
    reply_frame: int
    reply_time: int


_ROW = Struct("=5q")
_pack = _ROW.pack
ROW_SIZE = _ROW.size


class SetPointBatch:
    """Set points in the order in which they were sent.

    Attributes:
        handle: value of the robot's handle, as it stands in the requests; set by who knows it.
        row_data: a row each, as 64-bit integers.
        requests: bytes of the first requests.
        results: bytes of the accepted replies.
        irregular: place and call of those that have more to tell: not answered, not with S_OK, or sent or
            answered more than once.
    """

    __slots__ = ("handle", "irregular", "requests", "results", "row_data")

    def __init__(self) -> None:
        self.handle = b""
        self.row_data = bytearray()
        self.requests, self.results = FrameBytes(), FrameBytes()
        self.irregular: list[tuple[int, Call]] = []

    def __len__(self) -> int:
        return len(self.row_data) // _ROW.size

    def __getitem__(self, index: int) -> SetPointRow:
        start = (index if index >= 0 else len(self) + index) * _ROW.size
        return SetPointRow(*_ROW.unpack_from(self.row_data, start))

    def add_plain(self, call: Call, reply: FrameObservation) -> bool:
        """Add a set point that was sent once and answered with S_OK, if it looks like the others.

        Returns:
            False, with nothing done, where it has more to tell, another handle or another size.
        """
        frame: int
        time: int
        reply_frame: int
        replied: int
        item: Frame
        result: Frame
        # Taken apart so in less time than attribute by attribute.
        frame, time, _, _, item, _ = call.request  # type: ignore[misc]  # a tuple behind its protocol
        reply_frame, replied, _, _, result, _ = reply  # type: ignore[misc]  # the same
        raw, answer, reserved = item.raw, result.raw, item.reserved
        requests, results = self.requests, self.results
        if (
            result.code
            or raw[HANDLE_VALUE_BYTES] != self.handle
            or len(raw) != requests.size
            or len(answer) != results.size
            or (reserved and reserved != item.serial and not call.first_attempt_seen)
        ):
            return False
        try:
            self.row_data += _pack(call.number, frame, time, reply_frame, replied)
        except struct.error:  # a time beyond 64 bits
            return False
        requests.data += raw
        results.data += answer
        return True

    def add(self, call: Call) -> None:
        """Add a set point of any kind."""
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
        """Return calls, frames, times, reply frames and times of replies, one behind the other."""
        rows = np.frombuffer(self.row_data, np.int64).reshape(-1, len(SetPointRow._fields))
        return np.ascontiguousarray(rows.T)

    def clear(self) -> None:
        """Forget all set points; columns made of them stay as they are."""
        self.row_data = bytearray()
        self.requests.clear()
        self.results.clear()
        self.irregular.clear()


def _clip_time(time: int) -> int:
    return min(max(time, -LATEST_TIME), LATEST_TIME)
