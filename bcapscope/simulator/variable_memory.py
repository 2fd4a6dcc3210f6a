"""The numbered variables and the I/O of the simulated controller.

Sources for the VARIANT type that belongs to each letter: ShoheiKobata/orin_bcap_python_samples SimpleSamples
and DENSORobot/denso_robot_ros2. On a real controller, the number of variables of each letter is a setting;
the simulator has one number for all letters.
"""

from __future__ import annotations

import struct

from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.simulator import argument_values
from bcapscope.simulator.call_outcome import BAD_INDEX, OUT_OF_MEMORY, OVERFLOW, TYPE_MISMATCH, RefusedError

VARIABLES_PER_LETTER = 100
"""Variables of each letter."""

IO_BYTES = 64
"""512 bits, IO0 to IO511."""

LONGEST_TEXT = 247
"""Maximum length of an S variable on RC8, according to the manual's table of string variables. The limit is
not verified.
"""

_ROW_LENGTHS = {"V": 3, "P": 7, "J": 8, "T": 10}
_SCALARS = {"I": VT.I4, "F": VT.R4, "D": VT.R8}
_IO_WORDS = {
    "IOB": ("<h", 1, VT.I2),
    "IOW": ("<i", 2, VT.I4),
    "IOD": ("<i", 4, VT.I4),
    "IOF": ("<f", 4, VT.R4),
}
LETTERS = ("I", "F", "D", "V", "P", "J", "T", "S")


class VariableMemory:
    """The variables that programs and clients share."""

    def __init__(self, real: VT) -> None:
        """Set all variables and I/O to zero; `real` is the VARIANT type of the numbers in vectors."""
        self._real = real
        self._numbers: dict[tuple[str, int], float] = {}
        self._rows: dict[tuple[str, int], tuple[float, ...]] = {}
        self._texts: dict[int, str] = {}
        self.io = bytearray(IO_BYTES)

    def read(self, letter: str, index: int) -> Variant:
        """Read a variable, or refuse an unknown one; an I/O variable has the index of its first bit."""
        if letter.startswith("IO"):
            return self._read_io(letter, index)
        _check(index)
        if letter == "S":
            return argument_values.bstr(self._texts.get(index, ""))
        if letter in _ROW_LENGTHS:
            zeros = (0.0,) * _ROW_LENGTHS[letter]
            return argument_values.float_array(self._real, self._rows.get((letter, index), zeros))
        number = self._numbers.get((letter, index), 0)
        return Variant(_SCALARS[letter], int(number) if letter == "I" else float(number))

    def write(self, letter: str, index: int, value: Variant) -> None:
        """Write a variable. Refuse a value that does not fit the variable; append zeros to a short vector."""
        if letter.startswith("IO"):
            self._write_io(letter, index, value)
            return
        _check(index)
        if letter == "S":
            self._texts[index] = _checked_text(value)
        elif letter in _ROW_LENGTHS:
            self._rows[letter, index] = vector_of(value, _ROW_LENGTHS[letter], self._real)
        else:
            self._numbers[letter, index] = _number(value, letter)

    def word(self, first: int) -> int:
        """Return 32 bits of I/O as a signed little-endian number. `first` is the first of these bits, a
        multiple of 8.
        """
        return int.from_bytes(self.io[first // 8 : first // 8 + 4], "little", signed=True)

    def write_word(self, first: int, word: int, mask: int) -> None:
        """Write 32 bits of I/O from bit `first`, but only the bits that are set in `mask`."""
        old = self.word(first) & 0xFFFFFFFF
        self.io[first // 8 : first // 8 + 4] = ((old & ~mask) | (word & mask)).to_bytes(4, "little")

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
            raise RefusedError(BAD_INDEX)


def _check(index: int) -> None:
    if not 0 <= index < VARIABLES_PER_LETTER:
        raise RefusedError(BAD_INDEX)


def _checked_text(value: Variant) -> str:
    if value.vt != VT.BSTR or not isinstance(value.value, str):
        raise RefusedError(TYPE_MISMATCH)
    if len(value.value) > LONGEST_TEXT:
        raise RefusedError(OUT_OF_MEMORY)
    return value.value


def vector_of(value: Variant, length: int, real: VT) -> tuple[float, ...]:
    """Convert an array to `length` numbers; missing numbers become 0. Refuse a value that cannot be
    converted.
    """
    if not value.vt & ARRAY:
        raise RefusedError(TYPE_MISMATCH)
    numbers = argument_values.numbers_of(value)
    if not 0 < len(numbers) <= length:
        raise RefusedError(TYPE_MISMATCH)
    if real == VT.R4:
        numbers = tuple(map(argument_values.clip_to_r4, numbers))
    return (*numbers, *(0.0,) * (length - len(numbers)))


def _number(value: Variant, letter: str) -> float:
    if value.vt & ARRAY or isinstance(value.value, str):
        raise RefusedError(TYPE_MISMATCH)
    number = argument_values.number_of(value)
    if letter == "I" and not -0x80000000 <= number <= 0x7FFFFFFF:
        raise RefusedError(OVERFLOW)
    if letter == "F" and abs(number) > argument_values.LARGEST_FLOAT:
        raise RefusedError(OVERFLOW)
    return number
