"""Cutting a byte stream into frames: any cut, any glue, and back into step after garbage."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

from bcapscope.protocol.codec.arguments import SMALLEST_ARGUMENT, Problem
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import (
    EOT,
    HEADER_SIZE,
    LARGEST_FRAME,
    SMALLEST_FRAME,
    SOH,
    Frame,
    Malformed,
)
from bcapscope.protocol.codec.frame_content import has_compressed_header

LARGEST_UNCONFIRMED = 64 * 1024
"""A frame whose length field its arguments do not bear out is waited for up to this size. Frames of real
sessions are below 10 KiB, so a corrupted length costs a bounded wait and not the rest of the stream."""

LARGEST_GARBAGE = 64 * 1024
"""Bytes outside of any frame come out in pieces of this size, so that they are never piled up."""

GUARANTEED_BUFFER = 16 * 1024
"""Bytes of an unfinished frame that are held even where the budget is exceeded: frames of real sessions are
below 10 KiB, so that a flood of long ones does not damage theirs."""

STREAM_ENDED = "the stream ends here"
"""Why the last frame of a stream is not whole."""

BUDGET_EXCEEDED = "incomplete: the unfinished frames of all connections exceed"
"""Why a frame in the middle of a stream is not whole."""

MAX_RESYNC_ARGUMENTS = 64
"""Arguments of a frame at which a stream may get back into step. No function takes more than four and no
reply has more than one; the bound keeps crafted garbage from being walked over and over."""

_TAILS = (1, 2, 3)
"""Bytes from the last argument to the end: EOT, with a mode byte (version 1), or with a CRC."""


class StreamPiece(NamedTuple):
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
    CONFIRMED = auto()
    """The arguments end where the length field says, or are compressed."""
    UNCONFIRMED = auto()
    """The length field is possible, but the arguments do not bear it out."""
    NONE = auto()
    """No frame begins here."""
    INCOMPLETE = auto()
    """More bytes are needed to tell."""


class StreamSplitter:
    """Cuts a stream into pieces; the result depends on the bytes alone, never on how they arrive.

    Every byte fed comes out in exactly one piece, in order. Held are at most `limit` bytes, or
    `LARGEST_GARBAGE` and `LARGEST_UNCONFIRMED` where that is more. Splitters that share a budget together
    hold no more than that, not counting `GUARANTEED_BUFFER` of each. A longer frame that exceeds the budget
    is returned unfinished.
    """

    def __init__(
        self, synchronized: bool = True, limit: int = LARGEST_FRAME, budget: ByteBudget | None = None
    ) -> None:
        """Begin a stream.

        Args:
            synchronized: the first byte fed is the first of a frame; False where the beginning was not seen.
            limit: the longest frame that is waited for, in bytes.
            budget: counts what this and other splitters hold; `close` gives it back.
        """
        self._buffer = bytearray()
        self._budget = budget or ByteBudget()
        self._stream_offset = 0
        self._synchronized = synchronized
        self._limit = limit
        self._scan_position = 0
        self._bytes_needed = 0
        self._argument_progress = (0, 0, 0)

    @property
    def pending_bytes(self) -> int:
        """Bytes fed that have not come out yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[StreamPiece]:
        """Take the next bytes of the stream and return the pieces that they complete."""
        start, frame = self._stream_offset, self.feed_whole_frame(data)
        if frame is not None:
            return [StreamPiece(start, self._stream_offset, frame)]
        self._buffer += data
        self._budget.held += len(data)
        pieces = [] if len(self._buffer) < self._bytes_needed else self._split(final=False)
        if len(self._buffer) > GUARANTEED_BUFFER and self._budget.is_exceeded:
            pieces += self._flush(f"{BUDGET_EXCEEDED} {self._budget.limit} bytes")
            self._synchronized = False
        return pieces

    def feed_whole_frame(self, data: bytes) -> Frame | None:
        """Take the next bytes of the stream if they are one whole frame, as they nearly always are.

        Returns:
            None for anything else, of which nothing is taken: it is for `feed`.
        """
        if self._buffer or not self._synchronized or not _is_one_frame(data) or len(data) > self._limit:
            return None
        self._stream_offset += len(data)
        return Frame(data)

    def add_gap(self, missing: int) -> list[StreamPiece]:
        """End what was begun, then account for `missing` bytes that will never come."""
        pieces = self._flush("what follows was not seen")
        start, self._stream_offset = self._stream_offset, self._stream_offset + missing
        reason = f"{missing} bytes of the stream were not seen"
        hole = Malformed(b"", (Problem(0, "gap", reason),), missing)
        self._synchronized = False
        return [*pieces, StreamPiece(start, self._stream_offset, hole)]

    def close(self) -> list[StreamPiece]:
        """End the stream: what is left comes out as it is."""
        return self._flush(STREAM_ENDED)

    def _flush(self, why: str) -> list[StreamPiece]:
        pieces = self._split(final=True)
        last = pieces[-1].item if pieces else None
        if last is None:
            return pieces
        note = Problem(len(last.raw), "cut", why)
        if isinstance(last, Frame) and last.length > len(last.raw):
            pieces[-1] = pieces[-1]._replace(item=Frame(last.raw, note))
        elif isinstance(last, Malformed) and last.raw[0] == SOH and len(last.raw) < HEADER_SIZE:
            pieces[-1] = pieces[-1]._replace(item=Malformed(last.raw, (*last.problems, note)))
        return pieces

    def _split(self, final: bool) -> list[StreamPiece]:
        pieces: list[StreamPiece] = []
        while self._buffer:
            size = self._next_piece_size(final)
            if size == 0:
                break
            pieces.append(self._pop_piece(size))
        if final:
            self._bytes_needed = 0
        return pieces

    def _pop_piece(self, size: int) -> StreamPiece:
        raw = bytes(memoryview(self._buffer)[:size])
        del self._buffer[:size]
        self._budget.held -= size
        start, self._stream_offset = self._stream_offset, self._stream_offset + size
        self._scan_position = self._bytes_needed = 0
        self._argument_progress = (0, 0, 0)
        return StreamPiece(start, self._stream_offset, self._frame_or_malformed(raw))

    def _frame_or_malformed(self, raw: bytes) -> Frame | Malformed:
        if raw[0] == SOH and len(raw) >= HEADER_SIZE:
            return Frame(raw)
        if raw[0] == SOH:
            return Malformed(raw, (Problem(0, "short", f"a frame breaks off after {len(raw)} bytes"),))
        return Malformed(raw, (Problem(0, "soh", "bytes outside of any frame"),))

    def _next_piece_size(self, final: bool) -> int:
        """Size of the piece that begins the buffer; 0 for "need more"."""
        if self._scan_position == 0 and self._synchronized and self._buffer[0] == SOH:
            trust, length = self._assess_header(0)
            if trust is _Trust.INCOMPLETE and not final:
                return 0
            if trust in (_Trust.CONFIRMED, _Trust.UNCONFIRMED):
                ends = self._frame_ends_at(length, trust, final)
                if ends is None and not final:
                    return 0
                if ends:
                    return length
        return self._resynchronize(final)

    def _frame_ends_at(self, length: int, trust: _Trust, final: bool) -> bool | None:
        """Tell whether the frame that begins the buffer ends behind `length` bytes, None for "need more".

        A byte other than EOT may be a damaged EOT where the next frame, or nothing, follows; where it is
        the SOH of the next frame, one byte too few was sent.
        """
        buffer = self._buffer
        if len(buffer) < length:
            self._bytes_needed = length
            return None
        if buffer[length - 1] == EOT or trust is not _Trust.CONFIRMED:
            return buffer[length - 1] == EOT
        if len(buffer) == length:
            self._bytes_needed = length + 1
            return True if final else None
        return buffer[length] == SOH

    def _resynchronize(self, final: bool) -> int:
        """Look for the next byte at which a frame begins beyond doubt; return the size of what is before."""
        pos = self._scan_position
        self._synchronized = False
        while (pos := self._buffer.find(SOH, pos, LARGEST_GARBAGE)) >= 0:
            self._scan_position = pos
            found = self._begins_frame(pos)
            if found:
                self._synchronized = True
                return pos or self._next_piece_size(final)
            if found is None and not final:
                return 0
            pos += 1
        self._scan_position = min(len(self._buffer), LARGEST_GARBAGE)
        return self._scan_position if final or self._scan_position == LARGEST_GARBAGE else 0

    def _begins_frame(self, pos: int) -> bool | None:
        """Tell whether a whole frame stands at `pos`, None for "need more"."""
        trust, length = self._assess_header(pos, synchronized=False)
        if trust is _Trust.CONFIRMED and len(self._buffer) >= pos + length:
            return self._buffer[pos + length - 1] == EOT
        if trust is _Trust.CONFIRMED:
            self._bytes_needed = pos + length
        return None if trust in (_Trust.CONFIRMED, _Trust.INCOMPLETE) else False

    def _assess_header(self, pos: int, synchronized: bool = True) -> tuple[_Trust, int]:
        """Judge the frame that may begin at `pos` by its header and the lengths of its arguments."""
        buffer = self._buffer
        if len(buffer) - pos < HEADER_SIZE:
            return _Trust.INCOMPLETE, 0
        length = int.from_bytes(buffer[pos + 1 : pos + 5], "little")
        argc = int.from_bytes(buffer[pos + 13 : pos + 15], "little")
        largest = self._limit if synchronized else min(self._limit, LARGEST_UNCONFIRMED)
        if not SMALLEST_FRAME <= length <= largest:
            return _Trust.NONE, 0
        packed = has_compressed_header(buffer, pos)
        if argc > MAX_RESYNC_ARGUMENTS and not synchronized and not packed:
            return _Trust.NONE, 0
        stop = pos + length
        last = stop - 1 if packed else self._walk_arguments(pos, stop, argc)
        if last is None:
            return _Trust.INCOMPLETE, length
        if stop - last in _TAILS:
            return _Trust.CONFIRMED, length
        return (_Trust.UNCONFIRMED if length <= LARGEST_UNCONFIRMED else _Trust.NONE), length

    def _walk_arguments(self, pos: int, stop: int, argc: int) -> int | None:
        """Follow the length fields of the arguments to the offset behind the last one.

        Goes on where it left off, so that a long frame in small cuts is walked once. Returns None for
        "need more" and 0 where the arguments cannot be right.
        """
        begun, argument, done = self._argument_progress
        if begun != pos or done == 0:
            argument, done = pos + HEADER_SIZE, 0
        while done < argc:
            if argument + SMALLEST_ARGUMENT > stop:
                return 0
            if argument + 4 > len(self._buffer):
                self._bytes_needed = argument + 4
                self._argument_progress = (pos, argument, done)
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
        and int.from_bytes(data[1:5], "little") == len(data) <= LARGEST_UNCONFIRMED
    )
