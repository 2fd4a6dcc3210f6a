"""Reading the arguments of a frame, sound or not."""

from __future__ import annotations

import struct
from typing import NamedTuple

from bcapscope.protocol.variant import (
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
from bcapscope.protocol.wording import counted

SMALLEST_ARGUMENT = 10
"""Bytes of an argument without data: u32 length, u16 type, u32 count."""

MOST_NUMBERS = 65_536
"""Elements of number arrays that are read of one frame; the bytes of a UI1 array do not count, as they are
one value. Frames of real sessions hold fewer than a thousand. Wireshark likewise stops at 1,000,000 items of
a packet (gui.max_tree_items)."""

MOST_VALUES = 2_048
"""Other values that are read of one frame: arguments, elements of VARIANT arrays and strings. Each takes some
2 µs and 200 bytes, so that the most crafted frame holds up a proxy for some 5 ms. With 8,192, a flood of
packed frames delayed Robot_Halt through a proxy with rules by 3 s. The longest lists of known sessions are of
names, a few hundred."""

MOST_PROBLEMS = 100
"""Problems of one frame that are listed; a frame can hold one in every seven bytes."""

_TYPE_COUNT = struct.Struct("<HI")
_U32 = struct.Struct("<I")


class Problem(NamedTuple):
    """Something in the bytes that is not as b-CAP has it.

    Attributes:
        offset: where in the frame's bytes.
        code: a short stable word for programs.
        reason: one clause for people.
    """

    offset: int
    code: str
    reason: str


class Argument(NamedTuple):
    """An argument of a frame and where it stands.

    Attributes:
        variant: the typed value, as far as its bytes go.
        start: offset of its length field.
        stop: offset behind its last byte.
    """

    variant: Variant
    start: int
    stop: int


class Number(NamedTuple):
    """Where plain numbers stand: `repeat` times the struct format character `code` from `start` on.

    The data of a UI1 array is one "number" of code ``s``.
    """

    start: int
    code: str
    repeat: int


class ArgumentReader:
    """Reads arguments from `pos` to `end`; never raises, never reads past `end`.

    The values decide where the next argument begins and the length field before each is only checked,
    as in DENSO's present libraries (orin_bcap C, C#, Java and Python ignore it). Where a value cannot
    be read to its end, the length field bounds it after all, as in the older C client, and bounds all
    that follow: so no byte is taken for part of two values, and each is looked at twice at the most.

    Attributes:
        arguments: what was read, the last one perhaps only in part.
        problems: what is not as it should be, in the order of the bytes.
        numbers: where plain numbers stand.
        pos: offset of the first byte that was not read.
        complete: every argument was found, though perhaps not all of its value.
    """

    def __init__(self, raw: bytes, pos: int, end: int) -> None:
        self.raw = raw
        self.pos = pos
        self.end = end
        self.arguments: list[Argument] = []
        self.problems: list[Problem] = []
        self.numbers: list[Number] = []
        self.complete = False
        self._bound = end
        self._lengths_rule = False
        self._lost = False
        self._numbers_left = MOST_NUMBERS
        self._values_left = MOST_VALUES
        self._exhausted = False

    def read(self, argc: int) -> None:
        """Read `argc` arguments, or as many as the bytes hold."""
        for index in range(argc):
            if self.end - self.pos < SMALLEST_ARGUMENT:
                self._report(self.pos, "argc", f"argument count is {argc}, bytes for {index}")
                return
            if not (self._spend_value() and self._read_one()):
                return
        self.complete = True

    def _report(self, offset: int, code: str, reason: str) -> None:
        if len(self.problems) < MOST_PROBLEMS:
            self.problems.append(Problem(offset, code, reason))
        elif len(self.problems) == MOST_PROBLEMS:
            self.problems.append(
                Problem(offset, "more", f"only the first {MOST_PROBLEMS} problems are listed")
            )

    def _lose(self, offset: int, code: str, reason: str) -> None:
        self._report(offset, code, reason)
        self._lost = True

    def _read_one(self) -> bool:
        """Read an argument; return whether it is known where the next one begins."""
        start = self.pos
        (claimed,) = _U32.unpack_from(self.raw, start)
        stop = start + 4 + claimed
        bounded = claimed >= SMALLEST_ARGUMENT - 4 and stop <= self.end
        known, left = len(self.problems), (self._numbers_left, self._values_left)
        variant = self._read_value(start, stop if bounded and self._lengths_rule else self.end)
        if self._lost and bounded and stop < self.end and not self._lengths_rule:
            self._lengths_rule = True
            variant = EMPTY  # lets go of what was read before it is read again
            del self.problems[known:]
            self._numbers_left, self._values_left = left
            self._exhausted = False
            variant = self._read_value(start, stop)
        if self._lost:
            self.pos = stop if bounded else self.end
            if variant.value == b"":
                variant = variant._replace(value=self.raw[start + SMALLEST_ARGUMENT : self.pos])
        elif self.pos != stop:
            taken = self.pos - start - 4
            self._report(
                start, "argument-length", f"argument length is {claimed}, type and value take {taken}"
            )
        self.arguments.append(Argument(variant, start, self.pos))
        return not self._exhausted and (bounded or not self._lost)

    def _read_value(self, start: int, bound: int) -> Variant:
        self.pos = start + 4
        self._bound = bound
        self._lost = False
        return self._variant(0)

    def _spend_value(self) -> bool:
        """Count one more value; return False if the frame has too many."""
        if not self._values_left:
            self._exhaust(f"{MOST_VALUES} values")
            return False
        self._values_left -= 1
        return True

    def _exhaust(self, what: str) -> None:
        self._exhausted = True
        self._lose(self.pos, "elements", f"the frame has more than {what}, the rest is not read")

    def _variant(self, depth: int) -> Variant:
        start = self.pos
        vt, count = _TYPE_COUNT.unpack_from(self.raw, start)
        self.pos = start + 6
        base = vt & ~ARRAY
        if vt & ARRAY:
            return Variant(vt, self._array(base, count, depth), count)
        value: Value = None
        if base in NUMBER_FORMATS:
            value = self._number(base)
        elif base == VT.BSTR:
            value = self._bstr()
        elif base not in (VT.EMPTY, VT.NULL):
            self._lose(start, "type", f"{vt_name(vt)} is no type that b-CAP carries")
            return Variant(vt, b"", count)
        if count != 1 and base > VT.NULL:
            self._report(start + 2, "count", f"element count of a scalar is {count}, read as one")
        return Variant(vt, value, count)

    def _array(self, base: int, count: int, depth: int) -> Value:
        if base == VT.UI1:
            return self._bytes(count)
        if base in NUMBER_FORMATS:
            return self._numbers(base, count)
        if base == VT.BSTR:
            return self._strings(count)
        if base == VT.VARIANT:
            return self._variants(count, depth)
        self._lose(self.pos - 6, "type", f"{vt_name(base | ARRAY)} is no type that b-CAP carries")
        return b""

    def _promise(self, count: int, vt: int, fits: int) -> None:
        elements = counted(count, "element")
        self._lose(self.pos, "data", f"{elements} of {vt_name(vt)} promised, bytes for {fits}")

    def _number(self, base: int) -> Value:
        if self._bound - self.pos < NUMBER_WIDTHS[base]:
            self._promise(1, base, 0)
            return None
        return self._unpacked(base, 1)[0]

    def _numbers(self, base: int, count: int) -> tuple[Value, ...]:
        there = min(count, (self._bound - self.pos) // NUMBER_WIDTHS[base])
        fits = min(there, self._numbers_left)
        self._numbers_left -= fits
        values = self._unpacked(base, fits)
        if fits < there:
            self._exhaust(f"{MOST_NUMBERS} numbers")
        elif there < count:
            self._promise(count, base, there)
        return values

    def _unpacked(self, base: int, count: int) -> tuple[Value, ...]:
        code = NUMBER_FORMATS[base]
        values = struct.unpack_from(f"<{count}{code}", self.raw, self.pos)
        if count and base != VT.BOOL:
            self.numbers.append(Number(self.pos, code, count))
        self.pos += count * NUMBER_WIDTHS[base]
        return tuple(value != 0 for value in values) if base == VT.BOOL else values

    def _bytes(self, count: int) -> bytes:
        start = self.pos
        self.pos = min(start + count, self._bound)
        if self.pos < start + count:
            self._promise(count, VT.UI1, self.pos - start)
        if self.pos > start:
            self.numbers.append(Number(start, "s", self.pos - start))
        return self.raw[start : self.pos]

    def _bstr(self) -> str | None:
        if self._bound - self.pos < 4:
            self._lose(self.pos, "data", "bytes end before the length of a string")
            return None
        (size,) = _U32.unpack_from(self.raw, self.pos)
        start = self.pos + 4
        stop = min(start + size, self._bound)
        if size % 2:
            self._report(self.pos, "string", f"string length is {size}, UTF-16 takes two bytes a unit")
        if stop < start + size:
            self._lose(self.pos, "data", f"a string of {size} bytes promised, there are {stop - start}")
        self.pos = stop
        return self.raw[start : stop - (stop - start) % 2].decode("utf-16-le", "surrogatepass")

    def _strings(self, count: int) -> tuple[Value, ...]:
        values: list[Value] = []
        while len(values) < count and not self._lost and self._spend_value():
            value = self._bstr()
            if value is not None:
                values.append(value)
        return tuple(values)

    def _variants(self, count: int, depth: int) -> tuple[Variant, ...]:
        values: list[Variant] = []
        if depth == MAX_NESTING:
            self._lose(self.pos, "nesting", f"VARIANT arrays nested more than {MAX_NESTING} deep")
            return ()
        while len(values) < count and not self._lost:
            if self._bound - self.pos < _TYPE_COUNT.size:
                self._promise(count, VT.VARIANT, len(values))
                break
            if not self._spend_value():
                break
            values.append(self._variant(depth + 1))
        return tuple(values)
