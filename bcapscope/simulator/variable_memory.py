"""The numbered variables and the I/O of the simulated controller."""

from __future__ import annotations

import struct

from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.simulator import argument_values
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError

VARIABLES_PER_LETTER = 100

MAX_FRAMES = 64
"""Number of tool coordinate systems, and of work coordinate systems. This number is an assumption."""

IO_BYTES = 64
"""512 bits, IO0 to IO511."""

LONGEST_TEXT = 247
"""Maximum length of an S variable, as in the RC8 manual's table of string variables; not verified."""

LETTERS = ("I", "F", "D", "V", "P", "J", "T", "S")
FRAMES = ("TOOL", "WORK")
"""Coordinate systems of tools and work: X, Y, Z [mm], Rx, Ry, Rz [deg]; all values are 0 if undefined."""

_ROW_LENGTHS = {"V": 3, "P": 7, "J": 8, "T": 10, **dict.fromkeys(FRAMES, 6)}
_SCALARS = {"I": VT.I4, "F": VT.R4, "D": VT.R8}
_IO_WORDS = {
    "IOB": ("<h", 1, VT.I2),
    "IOW": ("<i", 2, VT.I4),
    "IOD": ("<i", 4, VT.I4),
    "IOF": ("<f", 4, VT.R4),
}


class VariableMemory:
    def __init__(self, real: VT) -> None:
        """`real` is the VARIANT type of the numbers in vectors."""
        self._real = real
        self._values: dict[tuple[str, int], Variant] = {}
        self.io = bytearray(IO_BYTES)

    def read(self, letter: str, index: int) -> Variant:
        """Read a variable; refuse an unknown variable. For an I/O variable, `index` is the first bit."""
        if letter.startswith("IO"):
            return self._read_io(letter, index)
        check_index(letter, index)
        value = self._values.get((letter, index))
        return self._zero(letter) if value is None else value

    def write(self, letter: str, index: int, value: Variant) -> None:
        """Write a variable. Refuse a value that does not fit the variable; append zeros to a short vector."""
        if letter.startswith("IO"):
            self._write_io(letter, index, value)
            return
        if letter not in FRAMES:
            check_index(letter, index)
        if letter == "S":
            _check_text(value)
        elif letter in _ROW_LENGTHS:
            value = argument_values.float_array(self._real, _vector(value, letter))
        else:
            number = _number(value, letter)
            value = Variant(_SCALARS[letter], int(number) if letter == "I" else float(number))
        check_index(letter, index, is_write=True)  # a bad value of TOOL or WORK is refused before a bad index
        self._values[letter, index] = value

    def _zero(self, letter: str) -> Variant:
        if letter == "S":
            return argument_values.bstr("")
        if letter in _ROW_LENGTHS:
            return argument_values.float_array(self._real, (0.0,) * _ROW_LENGTHS[letter])
        return Variant(_SCALARS[letter], 0 if letter == "I" else 0.0)

    def _read_io(self, letter: str, index: int) -> Variant:
        if letter == "IO":
            self._check_bit_range(index, 1)
            return argument_values.boolean(bool(self.io[index // 8] >> index % 8 & 1))
        form, size, vt = _IO_WORDS[letter]
        self._check_bit_range(index, size * 8)
        bits = int.from_bytes(self.io, "little") >> index & (1 << size * 8) - 1
        raw = bits.to_bytes(struct.calcsize(form), "little")
        return Variant(vt, struct.unpack(form, raw)[0])

    def _write_io(self, letter: str, index: int, value: Variant) -> None:
        if letter == "IO":
            self._put_bits(index, 1, int(argument_values.number_of(value) != 0))
            return
        form, size, _ = _IO_WORDS[letter]
        number = argument_values.number_of(value)
        raw = struct.pack("<f", argument_values.clip_to_r4(number)) if form == "<f" else None
        bits = int.from_bytes(raw, "little") if raw else int(number) & (1 << size * 8) - 1
        self._put_bits(index, size * 8, bits)

    def _put_bits(self, index: int, count: int, bits: int) -> None:
        self._check_bit_range(index, count)
        mask = (1 << count) - 1 << index
        whole = int.from_bytes(self.io, "little") & ~mask | bits << index & mask
        self.io[:] = whole.to_bytes(IO_BYTES, "little")

    def _check_bit_range(self, index: int, count: int) -> None:
        if not 0 <= index <= IO_BYTES * 8 - count:
            raise RefusedError(RefusalCode.BAD_INDEX)


def check_index(letter: str, index: int, is_write: bool = False) -> None:
    """Refuse the index of a variable that does not exist. Tool 0 and work 0 exist, but are read-only."""
    first, count = (int(is_write), MAX_FRAMES) if letter in FRAMES else (0, VARIABLES_PER_LETTER)
    if not first <= index < count:
        raise RefusedError(RefusalCode.BAD_INDEX)


def _check_text(value: Variant) -> None:
    if value.vt != VT.BSTR or not isinstance(value.value, str):
        raise RefusedError(RefusalCode.TYPE_MISMATCH)
    if len(value.value) > LONGEST_TEXT:
        raise RefusedError(RefusalCode.OUT_OF_MEMORY)


def _vector(value: Variant, letter: str) -> tuple[float, ...]:
    """Convert an array to the numbers of a vector. For a coordinate system, drop the seventh number (Fig)."""
    if not value.vt & ARRAY:
        raise RefusedError(RefusalCode.TYPE_MISMATCH)
    numbers, length = argument_values.numbers_of(value), _ROW_LENGTHS[letter]
    if not 0 < len(numbers) <= length + (letter in FRAMES):
        raise RefusedError(RefusalCode.TYPE_MISMATCH)
    return (*numbers, *(0.0,) * (length - len(numbers)))[:length]


def _number(value: Variant, letter: str) -> float:
    if value.vt & ARRAY or isinstance(value.value, str):
        raise RefusedError(RefusalCode.TYPE_MISMATCH)
    number = argument_values.number_of(value)
    if letter == "I" and not -0x80000000 <= number <= 0x7FFFFFFF:
        raise RefusedError(RefusalCode.OVERFLOW)
    if letter == "F" and abs(number) > argument_values.LARGEST_FLOAT:
        raise RefusedError(RefusalCode.OVERFLOW)
    return number
