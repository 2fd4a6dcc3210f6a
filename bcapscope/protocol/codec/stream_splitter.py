"""Split a byte stream into frames, and find the next frame after garbage."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

from bcapscope.messages import Message
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
from bcapscope.protocol.codec.frame_template import FrameTemplates

LARGEST_UNCONFIRMED = 64 << 10
"""Maximum length in bytes of a frame if its arguments do not end where its length field says. With this
limit, a corrupted length field delays at most 64 KiB of the stream. Real frames are below 10 KiB.
"""

LARGEST_GARBAGE = 64 << 10
"""Maximum size in bytes of a piece of garbage: bytes that belong to no frame."""

GUARANTEED_BUFFER = 16 << 10
"""Number of bytes of an unfinished frame that a splitter keeps even if the splitters of all connections
together exceed their `ByteBudget`. Frames of real sessions are below 10 KiB, so a splitter can always keep
such a frame until it is complete.
"""

STREAM_ENDED = Message("problem.cut.stream-ended")
"""Reason that the splitter reports for an incomplete frame at the end of a stream."""

MAX_RESYNC_ARGUMENTS = 64
"""After garbage, the splitter accepts only a frame with at most this number of arguments. Without the limit,
malicious garbage could make the splitter read the same bytes many times. Real frames have at most four
arguments.
"""

_NO_ARGUMENT = (0, 0, 0)

_TAILS = (1, 2, 3)
"""Possible numbers of bytes after the last argument: 1 (EOT), 2 (mode byte, EOT) or 3 (CRC, EOT)."""


class StreamPiece(NamedTuple):
    """A frame, bytes between frames, or a gap. `start` and `stop` are offsets in the original stream, so
    missing bytes count too.
    """

    start: int
    stop: int
    item: Frame | Malformed


class _Trust(Enum):
    CONFIRMED = auto()
    """The arguments end where the length field says. Every compressed frame also counts as `CONFIRMED`."""
    UNCONFIRMED = auto()
    """The number in the length field is plausible, but the arguments do not confirm this number."""
    NONE = auto()
    """No frame begins here."""
    INCOMPLETE = auto()
    """The splitter needs more bytes to decide."""


class StreamSplitter:
    """Splits a stream into frames and garbage, however the stream is divided into segments.

    Every byte of the stream is in exactly one piece, in order. A splitter holds at most as many bytes as the
    largest of `limit`, `LARGEST_GARBAGE` and `LARGEST_UNCONFIRMED`. Splitters with a shared budget together
    hold no more than the budget, plus `GUARANTEED_BUFFER` for each splitter. While the budget is exceeded, a
    splitter does not wait for the rest of a long frame: if `feed` leaves more than `GUARANTEED_BUFFER` bytes
    in the buffer, it returns these bytes at once.
    """

    def __init__(
        self,
        synchronized: bool = True,
        limit: int = LARGEST_FRAME,
        budget: ByteBudget | None = None,
        templates: FrameTemplates | None = None,
    ) -> None:
        """Start a stream. If not `synchronized`, the stream may begin in the middle of a frame. The splitter
        waits for frames of at most `limit` bytes.
        """
        self._buffer = bytearray()
        self._budget = budget or ByteBudget()
        self._templates = templates
        self._stream_offset = 0
        self._synchronized = synchronized
        self._limit = limit
        self._scan_position = 0
        self._bytes_needed = 0
        self._argument_progress = _NO_ARGUMENT

    @property
    def pending_bytes(self) -> int:
        return len(self._buffer)

    def feed(self, data: bytes) -> list[StreamPiece]:
        """Add the next bytes of the stream and return the pieces that are now complete."""
        start, frame = self._stream_offset, self.feed_whole_frame(data)
        if frame is not None:
            return [StreamPiece(start, self._stream_offset, frame)]
        self._buffer += data
        self._budget.held += len(data)
        pieces = [] if len(self._buffer) < self._bytes_needed else self._split(final=False)
        if len(self._buffer) > GUARANTEED_BUFFER and self._budget.is_exceeded:
            pieces += self._flush(Message("problem.cut.memory", limit=self._budget.limit))
            self._synchronized = False
        return pieces

    def feed_whole_frame(self, data: bytes) -> Frame | None:
        """If `data` is exactly one frame, return it faster than `feed` does. Otherwise, consume nothing."""
        if self._buffer or not self._synchronized or not _is_one_frame(data) or len(data) > self._limit:
            return None
        self._stream_offset += len(data)
        return Frame(data, None, self._templates)

    def add_gap(self, missing: int) -> list[StreamPiece]:
        """Return the pieces of the unfinished bytes, then a piece for the gap of `missing` bytes."""
        pieces = self._flush(Message("problem.cut.unseen"))
        start, self._stream_offset = self._stream_offset, self._stream_offset + missing
        hole = Malformed(b"", (Problem(0, "gap", Message("problem.gap", missing=missing)),), missing)
        self._synchronized = False
        return [*pieces, StreamPiece(start, self._stream_offset, hole)]

    def close(self) -> list[StreamPiece]:
        """End the stream and return its unfinished bytes."""
        return self._flush(STREAM_ENDED)

    def _flush(self, why: Message) -> list[StreamPiece]:
        pieces = self._split(final=True)
        last = pieces[-1].item if pieces else None
        if last is None:
            return pieces
        note = Problem(len(last.raw), "cut", why)
        if isinstance(last, Frame) and last.length > len(last.raw):
            pieces[-1] = pieces[-1]._replace(item=Frame(last.raw, note, self._templates))
        elif isinstance(last, Malformed) and last.raw[0] == SOH:
            pieces[-1] = pieces[-1]._replace(item=Malformed(last.raw, (*last.problems, note)))
        return pieces

    def _split(self, final: bool) -> list[StreamPiece]:
        pieces: list[StreamPiece] = []
        while self._buffer:
            size = self._next_piece_size(final)
            if size == 0:
                break
            pieces.append(self._pop_piece(size))
        return pieces

    def _pop_piece(self, size: int) -> StreamPiece:
        raw = bytes(memoryview(self._buffer)[:size])
        del self._buffer[:size]
        self._budget.held -= size
        start, self._stream_offset = self._stream_offset, self._stream_offset + size
        self._scan_position = self._bytes_needed = 0
        self._argument_progress = _NO_ARGUMENT
        return StreamPiece(start, self._stream_offset, self._frame_or_malformed(raw))

    def _frame_or_malformed(self, raw: bytes) -> Frame | Malformed:
        if raw[0] == SOH and len(raw) >= HEADER_SIZE:
            return Frame(raw, None, self._templates)
        if raw[0] == SOH:
            return Malformed(raw, (Problem(0, "short", Message("problem.short.cut", size=len(raw))),))
        return Malformed(raw, (Problem(0, "soh", Message("problem.soh.outside")),))

    def _next_piece_size(self, final: bool) -> int:
        """Return the size of the piece at the start of the buffer; 0 if more bytes are needed."""
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
        """Return whether the buffer begins with a frame of `length` bytes; None if more bytes are needed. A
        last byte other than EOT counts as a damaged EOT if SOH or the end of the stream follows.
        """
        buffer = self._buffer
        if len(buffer) < length:
            self._bytes_needed = length
            return None
        if buffer[length - 1] == EOT or trust is not _Trust.CONFIRMED:
            return buffer[length - 1] == EOT
        if len(buffer) == length:
            return True if final else None
        return buffer[length] == SOH

    def _resynchronize(self, final: bool) -> int:
        """Find the next whole frame in the buffer; return the number of bytes before that frame."""
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
        """Return whether a whole frame begins at `pos`; None if more bytes are needed."""
        trust, length = self._assess_header(pos, synchronized=False)
        if trust is _Trust.CONFIRMED and len(self._buffer) >= pos + length:
            return self._buffer[pos + length - 1] == EOT
        if trust is _Trust.CONFIRMED:
            self._bytes_needed = pos + length
        return None if trust in (_Trust.CONFIRMED, _Trust.INCOMPLETE) else False

    def _assess_header(self, pos: int, synchronized: bool = True) -> tuple[_Trust, int]:
        """Return whether a frame begins at `pos`, and its length, which counts only if a frame begins."""
        buffer = self._buffer
        length = int.from_bytes(buffer[pos + 1 : pos + 5], "little")
        if len(buffer) - pos < HEADER_SIZE:
            return _Trust.INCOMPLETE, length
        argc = int.from_bytes(buffer[pos + 13 : pos + 15], "little")
        largest = self._limit if synchronized else min(self._limit, LARGEST_UNCONFIRMED)
        if not SMALLEST_FRAME <= length <= largest:
            return _Trust.NONE, length
        packed = has_compressed_header(buffer, pos)
        if argc > MAX_RESYNC_ARGUMENTS and not synchronized and not packed:
            return _Trust.NONE, length
        stop = pos + length
        last = stop - 1 if packed else self._walk_arguments(pos, stop, argc)
        if last is None:
            return _Trust.INCOMPLETE, length
        if stop - last in _TAILS:
            return _Trust.CONFIRMED, length
        return (_Trust.UNCONFIRMED if length <= LARGEST_UNCONFIRMED else _Trust.NONE), length

    def _walk_arguments(self, pos: int, stop: int, argc: int) -> int | None:
        """Return the offset after the last argument; None if more bytes are needed, `stop` if a length field
        is impossible. Each call continues where the previous call stopped.
        """
        begun, argument, done = self._argument_progress
        if begun != pos or done == 0:
            argument, done = pos + HEADER_SIZE, 0
        while done < argc:
            if argument + SMALLEST_ARGUMENT > stop:
                return stop
            if argument + 4 > len(self._buffer):
                self._bytes_needed = argument + 4
                self._argument_progress = (pos, argument, done)
                return None
            claimed = int.from_bytes(self._buffer[argument : argument + 4], "little")
            if claimed < SMALLEST_ARGUMENT - 4:
                return stop
            argument += 4 + claimed
            done += 1
        return argument


def _is_one_frame(data: bytes) -> bool:
    return (
        len(data) >= SMALLEST_FRAME
        and data[0] == SOH
        and data[-1] == EOT
        and int.from_bytes(data[1:5], "little") == len(data) <= LARGEST_UNCONFIRMED
    )
