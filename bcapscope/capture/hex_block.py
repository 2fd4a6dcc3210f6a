"""Blocks: consecutive rows of hex that belong together."""

from __future__ import annotations

from bisect import bisect_right
from copy import copy
from operator import itemgetter

from bcapscope.capture.hex_line import HexDigits
from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.traffic.observation import Direction

LARGEST_REPEAT = 64 * 1024
"""Maximum number of repeated bytes that one asterisk line of a dump may stand for."""

LARGEST_BLOCK = 256 * 1024
"""Maximum number of bytes per block, enough for many frames. A longer dump becomes several blocks."""

MAX_ROWS = 16 * 1024
"""Maximum number of rows per block. A block of this many rows of 16 bytes has the size `LARGEST_BLOCK`."""

_LARGEST_HOLE = 4096
"""Maximum number of bytes that may be missing between two rows. After a longer gap, a new block begins."""

_BASES = {7: (16, 10, 8)}
"""Possible bases of an offset that has 7 characters: hexdump prints 7 hexadecimal digits, and `od` prints 7
octal or decimal digits. An offset of another length has base 16.
"""


class HexBlock:
    """Consecutive rows of hex in a text, with nothing between them.

    Attributes:
        caption: Words in the text above the block.
        direction: Direction that the caption states; None if the caption states no direction.
        is_captioned: Whether no other hex is between caption and block.
        offset: Offset written before the first row; "" if the first row has no offset.
        indent: Column of the first row's offset; -1 if the first row has no offset.
        is_hex_only: Whether the lines of the block hold nothing but hex, offsets and characters.
        has_hex_notation: Whether a row has a notation that is used only for hex, such as 0x.
        asterisk_bytes: Maximum number of bytes that the asterisk after the last row may stand for.
        notes: What is unusual in the text.
    """

    def __init__(
        self, caption: str, direction: Direction | None, is_captioned: bool, first: HexDigits
    ) -> None:
        self.caption = caption
        self.direction = direction
        self.is_captioned = is_captioned
        self.offset = first.offset
        self.indent = first.indent if first.offset else -1
        self.starts_at_zero = bool(first.offset) and not first.offset.strip("0:")
        self.is_hex_only = True
        self.has_hex_notation = False
        self.blank_line_follows = False
        self.asterisk_bytes = 0
        self.notes: list[Message] = []
        self._digits = bytearray()
        self._skipped = 0
        self._rows: list[tuple[int, int]] = []
        self._bases: tuple[int, ...] = _BASES.get(len(first.offset), (16,))

    @property
    def digits(self) -> str:
        return self._digits.decode("ascii")

    @property
    def size(self) -> int:
        return len(self._digits) // 2

    @property
    def is_full(self) -> bool:
        return self.size >= LARGEST_BLOCK or len(self._rows) >= MAX_ROWS

    @property
    def data(self) -> bytes:
        """The bytes of the block, without a last byte that has only one digit."""
        return bytes.fromhex(self.digits[: 2 * self.size])

    def line_numbers(self) -> list[tuple[int, int]]:
        """For each row, return its byte offset in the block and its line number."""
        return [(place // 2, line) for place, line in self._rows]

    def add(self, line: int, row: HexDigits) -> None:
        self._rows.append((len(self._digits), line))
        self._digits += row.digits.encode("ascii")
        self.is_hex_only = self.is_hex_only and row.is_hex_only
        self.has_hex_notation = self.has_hex_notation or row.has_hex_notation
        self.blank_line_follows = False

    def split(self, offset: int) -> HexBlock:
        """Move the bytes from `offset` on to a new block, and return the new block. The caller adds the next
        rows of the text to the new block.

        If `offset` is 0, or if more than `MAX_ROWS // 2` rows would move, move only the last row, and add a
        note to the new block.
        """
        first = bisect_right(self._rows, 2 * offset, key=itemgetter(0)) - 1
        note = None
        if not offset or len(self._rows) - first > MAX_ROWS // 2:
            first = len(self._rows) - 1
            offset = self._rows[first][0] // 2
            note = Message("pasted.continues", line=self._rows[first][1])
        rows = self._rows[first:]
        rest = copy(self)
        rest._rows = [(max(count - 2 * offset, 0), line) for count, line in rows]
        rest._digits = self._digits[2 * offset :]
        rest._skipped += offset
        rest.notes = [note] if note else []
        self._rows = self._rows[: first + (rows[0][0] < 2 * offset)]
        del self._digits[2 * offset :]
        return rest

    def extend(self, other: HexBlock) -> None:
        self._rows += [(len(self._digits) + place, line) for place, line in other._rows]
        self._digits += other._digits
        self.notes += other.notes

    def fit_to_offset(self, offset: str, line: int) -> bool:
        """Fill the gap before a row at `offset`. If the block goes beyond `offset`, remove the bytes from
        there on: they are text mistaken for hex. Return False if the row cannot continue this block.
        """
        size = self.size
        places = [(base, self._position_of(offset, base)) for base in self._bases]
        exact = tuple(base for base, place in places if place == size)
        if exact:
            self._bases = exact
            return True
        last = self._rows[-1][0] // 2
        for _, place in places:
            if place is None or place <= last:
                continue
            if place < size:
                del self._digits[2 * place :]
                return True
            if self._fill_gap(place - size, line):
                return True
        return False

    def _position_of(self, offset: str, base: int) -> int | None:
        """Convert an offset to a byte position in the block; None if the offset is no number in `base`."""
        try:
            return int(offset.rstrip(":"), base) - int(self.offset.rstrip(":"), base) - self._skipped
        except ValueError:
            return None

    def _fill_gap(self, count: int, line: int) -> bool:
        """Fill a gap of `count` bytes with copies of the last row if an asterisk stands for the gap.
        Otherwise, add a note that the bytes are missing. Return False if the gap is too large.
        """
        if count <= self.asterisk_bytes:
            row = self._digits[self._rows[-1][0] :]
            self._digits += (row * (2 * count // len(row) + 1))[: 2 * count]
            self.asterisk_bytes = 0
            return True
        if count > _LARGEST_HOLE:
            return False
        self._skipped += count
        self.notes.append(Message("pasted.missing", missing=Count(count, "byte"), line=line))
        return True
