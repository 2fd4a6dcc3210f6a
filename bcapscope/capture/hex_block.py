"""Rows of hex that belong together."""

from __future__ import annotations

from bisect import bisect_right
from copy import copy
from operator import itemgetter

from bcapscope.capture.hex_line import HexDigits
from bcapscope.traffic.observation import Direction

LARGEST_REPEAT = 64 * 1024
"""Bytes that an asterisk may stand for."""

LARGEST_BLOCK = 256 * 1024
"""Bytes of rows that form one block, room for many frames of real sessions; a longer dump is split."""

MAX_ROWS = 16 * 1024
"""Rows that form one block: as many bytes if each row has 16."""

_LARGEST_HOLE = 4096
"""Bytes by which the offset of a row may be ahead and the row still belong to those before it."""

_BASES = {7: (16, 10, 8)}
"""Number bases of offsets by how many digits they have: od prints seven, in any of these; others are hex."""


class HexBlock:
    """Rows of hex with nothing between them.

    Attributes:
        caption: the words above.
        direction: who sent it, by these words.
        is_captioned: the words are right above, with no other hex between.
        offset: written before the first row; else empty.
        indent: column of that offset.
        starts_at_zero: the offset says that this is the beginning.
        is_hex_only: there is nothing else in any of its lines.
        has_hex_notation: written as only hex is.
        blank_line_follows: a blank line follows.
        asterisk_bytes: bytes that an asterisk which follows may stand for, rows like the last; 0 where none
            follows.
        size: whole bytes.
        notes: what is odd about it.
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
        self.notes: list[str] = []
        self._parts: list[str] = []
        self._data: bytes | None = None
        self._digit_count = 0
        self._skipped = 0
        self._rows: list[tuple[int, int]] = []
        self._bases: tuple[int, ...] = _BASES.get(len(first.offset), (16,))

    @property
    def digits(self) -> str:
        """The digits of all rows."""
        return "".join(self._parts)

    @property
    def size(self) -> int:
        """How many bytes there are; half a byte at the end is left out."""
        return self._digit_count // 2

    @property
    def is_full(self) -> bool:
        """Whether no more rows may be added before it is split."""
        return self.size >= LARGEST_BLOCK or len(self._rows) >= MAX_ROWS

    @property
    def data(self) -> bytes:
        """The bytes; half a byte at the end is left out."""
        if self._data is None:
            self._data = bytes.fromhex(self.digits[: 2 * self.size])
        return self._data

    def line_numbers(self) -> list[tuple[int, int]]:
        """Return offset and line number of each row."""
        return [(place // 2, line) for place, line in self._rows]

    def add(self, line: int, row: HexDigits) -> None:
        """Put a row behind the others."""
        self._rows.append((self._digit_count, line))
        self._append(row.digits)
        self.is_hex_only = self.is_hex_only and row.is_hex_only
        self.has_hex_notation = self.has_hex_notation or row.has_hex_notation
        self.blank_line_follows = False

    def split(self, offset: int) -> HexBlock:
        """Cut the block and return the rest, to which rows are added as they would be to this one.

        Args:
            offset: offset of the rest; 0, or one that leaves too many rows, for the last row, which is noted
            then.
        """
        first = bisect_right(self._rows, 2 * offset, key=itemgetter(0)) - 1
        note = ""
        if not offset or len(self._rows) - first > MAX_ROWS // 2:
            first = len(self._rows) - 1
            offset = self._rows[first][0] // 2
            note = f"belongs to the bytes before line {self._rows[first][1]}, of which there are too many"
        digits, rows = self.digits, self._rows[first:]
        rest = copy(self)
        rest._rows = [(max(count - 2 * offset, 0), line) for count, line in rows]
        rest._parts, rest._digit_count = [], 0
        last = 2 * offset + rest._rows[-1][0]
        rest._append(digits[2 * offset : last])
        rest._append(digits[last:])
        rest._skipped += offset
        rest.notes = [note] if note else []
        self._rows = self._rows[: first + (rows[0][0] < 2 * offset)]
        self._parts, self._digit_count = [], 0
        self._append(digits[: 2 * offset])
        return rest

    def extend(self, other: HexBlock) -> None:
        """Put all rows of another block behind these."""
        self._rows += [(self._digit_count + place, line) for place, line in other._rows]
        self._append(other.digits)
        self.notes += other.notes

    def fit_to_offset(self, offset: str, line: int) -> bool:
        """Make the block end where `offset` says, if that is about where it ends; tell whether it is.

        Characters to the right of the last row, taken for hex, are dropped; what an asterisk stands for is
        put in. The offsets may be hexadecimal, decimal or octal.
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
                row = self._parts.pop()
                self._digit_count -= len(row)
                self._append(row[: 2 * (place - last)])
                return True
            if self._fill_gap(place - size, line):
                return True
        return False

    def _position_of(self, offset: str, base: int) -> int | None:
        """Return where in the block an offset is; None if it is none in that base."""
        try:
            return int(offset.rstrip(":"), base) - int(self.offset.rstrip(":"), base) - self._skipped
        except ValueError:
            return None

    def _append(self, digits: str) -> None:
        self._parts.append(digits)
        self._digit_count += len(digits)
        self._data = None

    def _fill_gap(self, count: int, line: int) -> bool:
        """Put in `count` bytes that are like the last row, or note that they are missing."""
        if count <= self.asterisk_bytes:
            row = self._parts[-1]
            self._append((row * (2 * count // len(row) + 1))[: 2 * count])
            self.asterisk_bytes = 0
            return True
        if count > _LARGEST_HOLE:
            return False
        self._skipped += count
        self.notes.append(f"{count} bytes are missing in the text before line {line}")
        return True
