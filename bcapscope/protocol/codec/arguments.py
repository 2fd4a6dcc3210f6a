"""Decode the arguments of any frame, even of a damaged frame."""

from __future__ import annotations

import struct
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.variant import (
    ARRAY,
    EMPTY,
    MAX_NESTING,
    NUMBER_FORMATS,
    NUMBER_WIDTHS,
    VT,
    Value,
    Variant,
    vt_name,
)

SMALLEST_ARGUMENT = 10
"""Size in bytes of the fields before an argument's data: u32 length, u16 type, u32 element count."""

MAX_NUMBERS = 65_536
"""Maximum number of elements to read from all number arrays of a frame together. UI1 arrays do not count."""

MAX_VALUES = 2_048
"""Maximum number of items (arguments, elements of VARIANT arrays, strings) to read from one frame. The
longest lists in known sessions hold a few hundred names. When the limit was 8,192, a flood of malicious
frames delayed Robot_Halt by 3 s in a proxy with rules.
"""

MAX_PROBLEMS = 100
"""Maximum number of problems to list; a malicious frame can contain one problem per seven bytes."""

_TYPE_COUNT = struct.Struct("<HI")
_U32 = struct.Struct("<I")


class Problem(NamedTuple):
    """One violation of b-CAP in the bytes of a frame.

    Attributes:
        offset: Offset in the frame's bytes.
        code: Short stable identifier for programs.
        reason: One clause that says what is wrong. JSON and filters use the English text of
            this clause.
    """

    offset: int
    code: str
    reason: Message


class Argument(NamedTuple):
    """An argument of a frame, with its position in the frame.

    Attributes:
        variant: The typed value of the argument; incomplete if the frame was truncated.
        start: Offset of the argument's length field.
        stop: Offset after the argument's last byte.
    """

    variant: Variant
    start: int
    stop: int


class NumberSpan(NamedTuple):
    """Adjacent numbers of one type: `start` is the offset of the first number, `code` is the type's character
    for Python's `struct`, and `repeat` is the count of numbers. For a UI1 array, `code` is ``s``.
    """

    start: int
    code: str
    repeat: int


class ArgumentReader:
    """Reads arguments from `pos` to `end`; never raises and never reads past `end`.

    An argument begins where the value of the previous argument ends. DENSO's present libraries (orin_bcap C,
    C#, Java and Python) ignore the length fields of arguments. The reader therefore only reports a length
    field that disagrees with the value. If the end of a value cannot be recognised, the reader reads this
    value again, up to the end that the argument's length field gives. From then on, the reader relies on
    length fields: it reads no value past the end that a plausible length field gives. Two values never share
    a byte, and the reader reads each byte at most twice.

    The last element of `arguments` may be incomplete. `is_complete` is True if the start of every argument
    was found.
    """

    def __init__(self, raw: bytes, pos: int, end: int) -> None:
        self.raw = raw
        self.pos = pos
        self.end = end
        self.arguments: list[Argument] = []
        self.problems: list[Problem] = []
        self.number_spans: list[NumberSpan] = []
        self.is_complete = False
        self._value_end = end
        self._trusts_lengths = False
        self._position_lost = False
        self._numbers_left = MAX_NUMBERS
        self._values_left = MAX_VALUES
        self._limit_reached = False

    def read(self, argc: int) -> None:
        """Read `argc` arguments, or fewer if the bytes end too soon."""
        for index in range(argc):
            if self.end - self.pos < SMALLEST_ARGUMENT:
                self._add_problem(self.pos, "argc", Message("problem.argc", claimed=argc, present=index))
                return
            if not (self._count_value() and self._read_argument()):
                return
        self.is_complete = True

    def _add_problem(self, offset: int, code: str, reason: Message) -> None:
        if len(self.problems) < MAX_PROBLEMS:
            self.problems.append(Problem(offset, code, reason))
        elif len(self.problems) == MAX_PROBLEMS:
            self.problems.append(Problem(offset, "more", Message("problem.more", n=MAX_PROBLEMS)))

    def _lose_position(self, offset: int, code: str, reason: Message) -> None:
        self._add_problem(offset, code, reason)
        self._position_lost = True

    def _read_argument(self) -> bool:
        """Read an argument. Return False if it is unknown where the next argument starts."""
        start = self.pos
        (claimed,) = _U32.unpack_from(self.raw, start)
        stop = start + 4 + claimed
        bounded = claimed >= SMALLEST_ARGUMENT - 4 and stop <= self.end
        known, left = len(self.problems), (self._numbers_left, self._values_left)
        variant = self._read_value(start, stop if bounded and self._trusts_lengths else self.end)
        if self._position_lost and bounded and not self._trusts_lengths:
            self._trusts_lengths = True
            variant = EMPTY  # release the memory of the incomplete value before the value is read again
            del self.problems[known:]
            self._numbers_left, self._values_left = left
            self._limit_reached = False
            variant = self._read_value(start, stop)
        if self._position_lost:
            self.pos = stop if bounded else self.end
            if variant.value == b"":
                variant = variant._replace(value=self.raw[start + SMALLEST_ARGUMENT : self.pos])
        elif self.pos != stop:
            taken = self.pos - start - 4
            self._add_problem(
                start, "argument-length", Message("problem.argument-length", claimed=claimed, taken=taken)
            )
        self.arguments.append(Argument(variant, start, self.pos))
        return not self._limit_reached and (bounded or not self._position_lost)

    def _read_value(self, start: int, bound: int) -> Variant:
        self.pos = start + 4
        self._value_end = bound
        self._position_lost = False
        return self._read_variant(0)

    def _count_value(self) -> bool:
        """Count a value of the frame; return False if the frame has more than `MAX_VALUES` values."""
        if not self._values_left:
            self._stop_at_limit(Message("problem.elements.values", n=MAX_VALUES))
            return False
        self._values_left -= 1
        return True

    def _stop_at_limit(self, limit: Message) -> None:
        self._limit_reached = True
        self._lose_position(self.pos, "elements", limit)

    def _read_variant(self, depth: int) -> Variant:
        start = self.pos
        vt, count = _TYPE_COUNT.unpack_from(self.raw, start)
        self.pos = start + 6
        base = vt & ~ARRAY
        if vt & ARRAY:
            return Variant(vt, self._read_array(base, count, depth), count)
        value: Value = None
        if base in NUMBER_FORMATS:
            value = self._read_number(base)
        elif base == VT.BSTR:
            value = self._read_bstr()
        elif base not in (VT.EMPTY, VT.NULL):
            self._lose_position(start, "type", Message("problem.type", type=vt_name(vt)))
            return Variant(vt, b"", count)
        if count != 1 and base > VT.NULL:
            self._add_problem(start + 2, "count", Message("problem.count", n=count))
        return Variant(vt, value, count)

    def _read_array(self, base: int, count: int, depth: int) -> Value:
        if base == VT.UI1:
            return self._read_bytes(count)
        if base in NUMBER_FORMATS:
            return self._read_numbers(base, count)
        if base == VT.BSTR:
            return self._read_strings(count)
        if base == VT.VARIANT:
            return self._read_variants(count, depth)
        self._lose_position(self.pos - 6, "type", Message("problem.type", type=vt_name(base | ARRAY)))
        return b""

    def _report_missing_data(self, count: int, vt: int, fits: int) -> None:
        reason = Message(
            "problem.data.elements", elements=Count(count, "element"), type=vt_name(vt), present=fits
        )
        self._lose_position(self.pos, "data", reason)

    def _read_number(self, base: int) -> Value:
        if self._value_end - self.pos < NUMBER_WIDTHS[base]:
            self._report_missing_data(1, base, 0)
            return None
        return self._unpack_numbers(base, 1)[0]

    def _read_numbers(self, base: int, count: int) -> tuple[Value, ...]:
        there = min(count, (self._value_end - self.pos) // NUMBER_WIDTHS[base])
        fits = min(there, self._numbers_left)
        self._numbers_left -= fits
        values = self._unpack_numbers(base, fits)
        if fits < there:
            self._stop_at_limit(Message("problem.elements.numbers", n=MAX_NUMBERS))
        elif there < count:
            self._report_missing_data(count, base, there)
        return values

    def _unpack_numbers(self, base: int, count: int) -> tuple[Value, ...]:
        code = NUMBER_FORMATS[base]
        values = struct.unpack_from(f"<{count}{code}", self.raw, self.pos)
        if count and base != VT.BOOL:
            self.number_spans.append(NumberSpan(self.pos, code, count))
        self.pos += count * NUMBER_WIDTHS[base]
        return tuple(value != 0 for value in values) if base == VT.BOOL else values

    def _read_bytes(self, count: int) -> bytes:
        start = self.pos
        self.pos = min(start + count, self._value_end)
        if self.pos < start + count:
            self._report_missing_data(count, VT.UI1, self.pos - start)
        if self.pos > start:
            self.number_spans.append(NumberSpan(start, "s", self.pos - start))
        return self.raw[start : self.pos]

    def _read_bstr(self) -> str | None:
        if self._value_end - self.pos < 4:
            self._lose_position(self.pos, "data", Message("problem.data.string-length"))
            return None
        (size,) = _U32.unpack_from(self.raw, self.pos)
        start = self.pos + 4
        stop = min(start + size, self._value_end)
        if size % 2:
            self._add_problem(self.pos, "string", Message("problem.string", size=size))
        if stop < start + size:
            reason = Message("problem.data.string", size=size, present=stop - start)
            self._lose_position(self.pos, "data", reason)
        self.pos = stop
        data = self.raw[start:stop]
        return data[: len(data) // 2 * 2].decode("utf-16-le", "surrogatepass")

    def _read_strings(self, count: int) -> tuple[Value, ...]:
        values: list[Value] = []
        while len(values) < count and not self._position_lost and self._count_value():
            value = self._read_bstr()
            if value is not None:
                values.append(value)
        return tuple(values)

    def _read_variants(self, count: int, depth: int) -> tuple[Variant, ...]:
        values: list[Variant] = []
        if depth == MAX_NESTING:
            self._lose_position(self.pos, "nesting", Message("problem.nesting", depth=MAX_NESTING))
        while len(values) < count and not self._position_lost:
            if self._value_end - self.pos < _TYPE_COUNT.size:
                self._report_missing_data(count, VT.VARIANT, len(values))
            elif self._count_value():
                values.append(self._read_variant(depth + 1))
        return tuple(values)
