"""Cutting a byte stream into frames: any cut, any glue, and back into step after garbage."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

from bcapscope.protocol.arguments import SMALLEST_ARGUMENT, Problem
from bcapscope.protocol.budget import Budget
from bcapscope.protocol.content import begins_zlib
from bcapscope.protocol.frame import (
    EOT,
    HEADER_SIZE,
    LARGEST_FRAME,
    SMALLEST_FRAME,
    SOH,
    Frame,
    Malformed,
)

LARGEST_DOUBTFUL = 64 * 1024
"""A frame whose length field its arguments do not bear out is waited for up to this size. Frames of real
sessions are below 10 KiB, so a corrupted length costs a bounded wait and not the rest of the stream."""

LARGEST_GARBAGE = 64 * 1024
"""Bytes outside of any frame come out in pieces of this size, so that they are never piled up."""

ALWAYS_HELD = 16 * 1024
"""Bytes of an unfinished frame that are held even where the budget is exceeded: frames of real sessions are
below 10 KiB, so that a flood of long ones does not damage theirs."""

STREAM_ENDS = "the stream ends here"
"""Why the last frame of a stream is not whole."""

NOT_AWAITED = "incomplete: the unfinished frames of all connections exceed"
"""Why a frame in the middle of a stream is not whole."""

MOST_ARGUMENTS = 64
"""Arguments of a frame at which a stream may get back into step. No function takes more than four and no
reply has more than one; the bound keeps crafted garbage from being walked over and over."""

_TAILS = (1, 2, 3)
"""Bytes from the last argument to the end: EOT, with a mode byte (version 1), or with a CRC."""


class Piece(NamedTuple):
    """A part of a stream.

    Attributes:
        start: offset in the stream of its first byte; a hole counts with the bytes it is missing.
        stop: offset behind its last byte.
        item: the frame, or bytes that are none.
    """

    start: int
    stop: int
    item: Frame | Malformed


class _Trust(Enum):
    FULL = auto()
    """The arguments end where the length field says, or are compressed."""
    DOUBT = auto()
    """The length field is possible, but the arguments do not bear it out."""
    NONE = auto()
    """No frame begins here."""
    OPEN = auto()
    """More bytes are needed to tell."""


class Splitter:
    """Cuts a stream into pieces; the result depends on the bytes alone, never on how they arrive.

    Every byte fed comes out in exactly one piece, in order. Held are at most `limit` bytes, or
    `LARGEST_GARBAGE` and `LARGEST_DOUBTFUL` where that is more. Splitters that share a budget together hold
    no more than that, not counting `ALWAYS_HELD` of each. A longer frame that exceeds the budget is returned
    unfinished.
    """

    def __init__(
        self, in_step: bool = True, limit: int = LARGEST_FRAME, budget: Budget | None = None
    ) -> None:
        """Begin a stream.

        Args:
            in_step: the first byte fed is the first of a frame; False where the beginning was not seen.
            limit: the longest frame that is waited for, in bytes.
            budget: counts what this and other splitters hold; `close` gives it back.
        """
        self._buffer = bytearray()
        self._budget = budget or Budget()
        self._base = 0
        self._in_step = in_step
        self._limit = limit
        self._scan = 0
        self._enough = 0
        self._walk = (0, 0, 0)

    @property
    def pending(self) -> int:
        """Bytes fed that have not come out yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Piece]:
        """Take the next bytes of the stream and return the pieces that they complete."""
        start, frame = self._base, self.feed_frame(data)
        if frame is not None:
            return [Piece(start, self._base, frame)]
        self._buffer += data
        self._budget.held += len(data)
        pieces = [] if len(self._buffer) < self._enough else self._cut(final=False)
        if len(self._buffer) > ALWAYS_HELD and self._budget.is_exceeded:
            pieces += self._end(f"{NOT_AWAITED} {self._budget.most} bytes")
            self._in_step = False
        return pieces

    def feed_frame(self, data: bytes) -> Frame | None:
        """Take the next bytes of the stream if they are one whole frame, as they nearly always are.

        Returns:
            None for anything else, of which nothing is taken: it is for `feed`.
        """
        if self._buffer or not self._in_step or not _is_one_frame(data) or len(data) > self._limit:
            return None
        self._base += len(data)
        return Frame(data)

    def gap(self, missing: int) -> list[Piece]:
        """End what was begun, then account for `missing` bytes that will never come."""
        pieces = self._end("what follows was not seen")
        start, self._base = self._base, self._base + missing
        reason = f"{missing} bytes of the stream were not seen"
        hole = Malformed(b"", (Problem(0, "gap", reason),), missing)
        self._in_step = False
        return [*pieces, Piece(start, self._base, hole)]

    def close(self) -> list[Piece]:
        """End the stream: what is left comes out as it is."""
        return self._end(STREAM_ENDS)

    def _end(self, why: str) -> list[Piece]:
        pieces = self._cut(final=True)
        last = pieces[-1].item if pieces else None
        if last is None:
            return pieces
        note = Problem(len(last.raw), "cut", why)
        if isinstance(last, Frame) and last.length > len(last.raw):
            pieces[-1] = pieces[-1]._replace(item=Frame(last.raw, note))
        elif isinstance(last, Malformed) and last.raw[0] == SOH and len(last.raw) < HEADER_SIZE:
            pieces[-1] = pieces[-1]._replace(item=Malformed(last.raw, (*last.problems, note)))
        return pieces

    def _cut(self, final: bool) -> list[Piece]:
        pieces: list[Piece] = []
        while self._buffer:
            size = self._next_size(final)
            if size == 0:
                break
            pieces.append(self._take(size))
        if final:
            self._enough = 0
        return pieces

    def _take(self, size: int) -> Piece:
        raw = bytes(memoryview(self._buffer)[:size])
        del self._buffer[:size]
        self._budget.held -= size
        start, self._base = self._base, self._base + size
        self._scan = self._enough = 0
        self._walk = (0, 0, 0)
        return Piece(start, self._base, self._item(raw))

    def _item(self, raw: bytes) -> Frame | Malformed:
        if raw[0] == SOH and len(raw) >= HEADER_SIZE:
            return Frame(raw)
        if raw[0] == SOH:
            return Malformed(raw, (Problem(0, "short", f"a frame breaks off after {len(raw)} bytes"),))
        return Malformed(raw, (Problem(0, "soh", "bytes outside of any frame"),))

    def _next_size(self, final: bool) -> int:
        """Size of the piece that begins the buffer; 0 for "need more"."""
        if self._scan == 0 and self._in_step and self._buffer[0] == SOH:
            trust, length = self._weigh(0)
            if trust is _Trust.OPEN and not final:
                return 0
            if trust in (_Trust.FULL, _Trust.DOUBT):
                ends = self._ends(length, trust, final)
                if ends is None and not final:
                    return 0
                if ends:
                    return length
        return self._find_step(final)

    def _ends(self, length: int, trust: _Trust, final: bool) -> bool | None:
        """Tell whether the frame that begins the buffer ends behind `length` bytes, None for "need more".

        A byte other than EOT may be a damaged EOT where the next frame, or nothing, follows; where it is
        the SOH of the next frame, one byte too few was sent.
        """
        buffer = self._buffer
        if len(buffer) < length:
            self._enough = length
            return None
        if buffer[length - 1] == EOT or trust is not _Trust.FULL:
            return buffer[length - 1] == EOT
        if len(buffer) == length:
            self._enough = length + 1
            return True if final else None
        return buffer[length] == SOH

    def _find_step(self, final: bool) -> int:
        """Look for the next byte at which a frame begins beyond doubt; return the size of what is before."""
        pos = self._scan
        self._in_step = False
        while (pos := self._buffer.find(SOH, pos, LARGEST_GARBAGE)) >= 0:
            self._scan = pos
            found = self._begins_frame(pos)
            if found:
                self._in_step = True
                return pos or self._next_size(final)
            if found is None and not final:
                return 0
            pos += 1
        self._scan = min(len(self._buffer), LARGEST_GARBAGE)
        return self._scan if final or self._scan == LARGEST_GARBAGE else 0

    def _begins_frame(self, pos: int) -> bool | None:
        """Tell whether a whole frame stands at `pos`, None for "need more"."""
        trust, length = self._weigh(pos, in_step=False)
        if trust is _Trust.FULL and len(self._buffer) >= pos + length:
            return self._buffer[pos + length - 1] == EOT
        if trust is _Trust.FULL:
            self._enough = pos + length
        return None if trust in (_Trust.FULL, _Trust.OPEN) else False

    def _weigh(self, pos: int, in_step: bool = True) -> tuple[_Trust, int]:
        """Judge the frame that may begin at `pos` by its header and the lengths of its arguments."""
        buffer = self._buffer
        if len(buffer) - pos < HEADER_SIZE:
            return _Trust.OPEN, 0
        length = int.from_bytes(buffer[pos + 1 : pos + 5], "little")
        argc = int.from_bytes(buffer[pos + 13 : pos + 15], "little")
        largest = self._limit if in_step else min(self._limit, LARGEST_DOUBTFUL)
        if not SMALLEST_FRAME <= length <= largest:
            return _Trust.NONE, 0
        packed = begins_zlib(buffer, pos)
        if argc > MOST_ARGUMENTS and not in_step and not packed:
            return _Trust.NONE, 0
        stop = pos + length
        last = stop - 1 if packed else self._walk_arguments(pos, stop, argc)
        if last is None:
            return _Trust.OPEN, length
        if stop - last in _TAILS:
            return _Trust.FULL, length
        return (_Trust.DOUBT if length <= LARGEST_DOUBTFUL else _Trust.NONE), length

    def _walk_arguments(self, pos: int, stop: int, argc: int) -> int | None:
        """Follow the length fields of the arguments to the offset behind the last one.

        Goes on where it left off, so that a long frame in small cuts is walked once. Returns None for
        "need more" and 0 where the arguments cannot be right.
        """
        begun, argument, done = self._walk
        if begun != pos or done == 0:
            argument, done = pos + HEADER_SIZE, 0
        while done < argc:
            if argument + SMALLEST_ARGUMENT > stop:
                return 0
            if argument + 4 > len(self._buffer):
                self._enough = argument + 4
                self._walk = (pos, argument, done)
                return None
            claimed = int.from_bytes(self._buffer[argument : argument + 4], "little")
            if claimed < SMALLEST_ARGUMENT - 4:
                return 0
            argument += 4 + claimed
            done += 1
        return argument


def _is_one_frame(data: bytes) -> bool:
    """Tell the common case: one segment holds one frame that the full walk would take as well."""
    return (
        len(data) >= SMALLEST_FRAME
        and data[0] == SOH
        and data[-1] == EOT
        and int.from_bytes(data[1:5], "little") == len(data) <= LARGEST_DOUBTFUL
    )
