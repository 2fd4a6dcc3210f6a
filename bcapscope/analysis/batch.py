"""Set points that wait until many are looked at together, in as little memory as they take."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.protocol.frame import Frame
from bcapscope.traffic.exchange import Exchange, FrameObservation

LARGE = 2048
"""Bytes; a set point has a tenth. Larger ones are kept aside."""

FURTHEST = (1 << 62) - 1
"""Nanoseconds since 1970, in the year 2116: the difference of two times no further off fits 64 bits. What a
damaged capture claims beyond counts as this."""

HANDLE_VALUE = slice(25, 29)
"""Where a request that is not compressed has the value of its first argument."""


class Bodies:
    """Frames of one direction, one behind the other.

    Attributes:
        size: of each in `data`; 0 as long as there is none.
        data: the frames, with zeros in the place of each that has another size.
        others: those, by place; b"" for one that is missing.
    """

    __slots__ = ("data", "others", "size")

    def __init__(self, raws: Iterable[bytes] = ()) -> None:
        self.size = 0
        self.data = bytearray()
        self.others: dict[int, bytes] = {}
        for place, raw in enumerate(raws):
            self.add(place, raw)

    def add(self, place: int, raw: bytes) -> None:
        """Add a frame behind `place` others; the first that is not large decides about the size of most."""
        if not self.size and 0 < len(raw) <= LARGE:
            self.size = len(raw)
            self.data += bytes(self.size * place)
        if raw and len(raw) == self.size:
            self.data += raw
        else:
            self.others[place] = raw
            self.data += bytes(self.size)

    def __getitem__(self, place: int) -> bytes:
        found = self.others.get(place)
        return bytes(self.data[place * self.size : (place + 1) * self.size]) if found is None else found

    def clear(self) -> None:
        """Forget all; the size of most is expected to stay."""
        self.data = bytearray()
        self.others = {}


class Row(NamedTuple):
    """What is kept of a set point besides its bytes.

    Attributes:
        call: its number.
        frame: of the first request.
        time: of that, nanoseconds since 1970-01-01 UTC.
        reply_frame: of the accepted reply; 0 where there is none.
        replied: time of that; that of the request where there is none.
    """

    call: int
    frame: int
    time: int
    reply_frame: int
    replied: int


_ROW = Struct("=5q")
_pack = _ROW.pack
HEAD_SIZE = _ROW.size


class Batch:
    """Set points in the order in which they were sent.

    Attributes:
        handle: value of the robot's handle, as it stands in the requests; set by who knows it.
        heads: a row each, as 64-bit integers.
        requests: bytes of the first requests.
        results: bytes of the accepted replies.
        odd: place and call of those that have more to tell: not answered, not with S_OK, or sent or answered
            more than once.
    """

    __slots__ = ("handle", "heads", "odd", "requests", "results")

    def __init__(self) -> None:
        self.handle = b""
        self.heads = bytearray()
        self.requests, self.results = Bodies(), Bodies()
        self.odd: list[tuple[int, Exchange]] = []

    def __len__(self) -> int:
        return len(self.heads) // _ROW.size

    def __getitem__(self, place: int) -> Row:
        start = (place if place >= 0 else len(self) + place) * _ROW.size
        return Row(*_ROW.unpack_from(self.heads, start))

    def keep(self, call: Exchange, reply: FrameObservation) -> bool:
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
            or raw[HANDLE_VALUE] != self.handle
            or len(raw) != requests.size
            or len(answer) != results.size
            or (reserved and reserved != item.serial and not call.origin_seen)
        ):
            return False
        try:
            self.heads += _pack(call.call, frame, time, reply_frame, replied)
        except struct.error:  # a time beyond 64 bits
            return False
        requests.data += raw
        results.data += answer
        return True

    def add(self, call: Exchange) -> None:
        """Add a set point of any kind."""
        place, request, reply = len(self), call.request, call.reply
        self.odd.append((place, call))
        self.requests.add(place, request.item.raw)
        self.results.add(place, b"" if reply is None else reply.item.raw)
        sent = _clipped(request.time)
        replied = sent if reply is None else _clipped(reply.time)
        self.heads += _pack(call.call, request.number, sent, 0 if reply is None else reply.number, replied)

    def columns(self) -> NDArray[np.int64]:
        """Return calls, frames, times, reply frames and times of replies, one behind the other."""
        rows = np.frombuffer(self.heads, np.int64).reshape(-1, len(Row._fields))
        return np.ascontiguousarray(rows.T)

    def clear(self) -> None:
        """Forget all set points; columns made of them stay as they are."""
        self.heads = bytearray()
        self.requests.clear()
        self.results.clear()
        self.odd.clear()


def _clipped(time: int) -> int:
    return min(max(time, -FURTHEST), FURTHEST)
