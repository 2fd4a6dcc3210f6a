"""What controllers execute of the bytes that a guard passed: an independent reading, and a lenient one.

DENSO's libraries disagree about damaged frames. These readers take whatever at least one of them takes:

* by values, as orin_bcap's C, C#, Java and Python: argument lengths and left-over bytes do not count, C# and
  Java do not look at the first byte;
* by lengths, as the older C client, which looks for the next 01 after whatever it rejects;
* unpacked, as the TCP side of keioku/bcap-python: the byte before EOT alone tells that a frame is compressed.

Names of commands are compared without case, up to a NUL and without blanks around them. Arguments beyond
those that a function has are ignored, except that a switch may take its last one.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS

Plain: TypeAlias = "int | float | str | bytes | tuple[Plain, ...] | None"

_WIDTHS = {2: "h", 3: "i", 4: "f", 5: "d", 6: "q", 7: "d", 10: "i", 11: "h", 17: "B", 18: "H", 19: "I"}
_WIDTHS |= {20: "q", 21: "Q"}
_BSTR, _VARIANT, _ARRAY = 8, 12, 0x2000
_HEADER, _SMALLEST = 15, 16

_EXECUTES = {function.id for function in FUNCTIONS.values() if function.name.endswith("_Execute")}
_READING_COMMANDS = {
    (each.function_id, each.name.lower())
    for function_id in _EXECUTES
    for each in commands_of(function_id)
    if each.effect is CallEffect.READS
}
_STOPS = {"Robot_Halt", "Robot_Hold", "Task_Stop", "Command_Cancel", "Controller_Disconnect", "Service_Stop"}
_OPENS = {"Service_Start", "Controller_Connect"}


class Executed(NamedTuple):
    """A request as one of the readers takes it."""

    function_id: int
    arguments: tuple[Plain, ...]

    @property
    def is_dangerous(self) -> bool:
        """Whether it is more than reading, opening, releasing and stopping."""
        function = FUNCTIONS.get(self.function_id)
        if function is None:
            return False  # every library refuses it
        verb = function.name.partition("_")[2]
        if function.name in _STOPS | _OPENS or verb == "Release":
            return False
        if self.function_id in _EXECUTES:
            return self._commands_danger()
        if verb == "GetFile":
            return not isinstance(_nth(self.arguments, 2), str) or "@create" in str(self.arguments[2]).lower()
        return not verb.startswith("Get")

    def _commands_danger(self) -> bool:
        given = _nth(self.arguments, 1)
        if not isinstance(given, str):
            return True
        name = given.partition("\0")[0].strip().lower()
        if (self.function_id, name) in ((17, "handstop"), (64, "twofgstop")):
            return False
        if (self.function_id, name) == (64, "slvchangemode"):
            values = self.arguments[2:]
            return not values or any(value not in (0, 0.0, "0") for value in values)
        return (self.function_id, name) not in _READING_COMMANDS


def executed(data: bytes, stream: bool) -> list[Executed]:
    """Read bytes in every way that a controller may."""
    found = [*_by_lengths(data)]
    found += _frames_by_values(data) if stream else _by_values(data)
    return found


def _frames_by_values(data: bytes) -> Iterator[Executed]:
    """Cut a stream into frames as orin_bcap's C does: skip to 01, then the length drives the read."""
    pos = data.find(b"\x01")
    while 0 <= pos <= len(data) - _SMALLEST:
        length = int.from_bytes(data[pos + 1 : pos + 5], "little")
        if length < _SMALLEST or pos + length > len(data):
            return
        yield from _by_values(data[pos : pos + length])
        yield from _unpacked(data[pos : pos + length])
        pos = data.find(b"\x01", pos + length)


def _by_values(raw: bytes) -> Iterator[Executed]:
    if len(raw) < _SMALLEST:
        return
    length, code, argc = struct.unpack_from("<xI4xIH", raw)
    if length > len(raw) or length < _SMALLEST or raw[length - 1] != 4:
        return
    arguments = _arguments(raw[_HEADER : length - 1], argc)
    if arguments is not None:
        yield Executed(code, arguments)


def _unpacked(raw: bytes) -> Iterator[Executed]:
    if raw[-2] != 1:
        return
    try:
        body = zlib.decompressobj().decompress(raw[13:-2], 1 << 20)
        code, argc = struct.unpack_from("<IH", body)
    except (zlib.error, struct.error):
        return
    arguments = _arguments(body[6:], argc)
    if arguments is not None:
        yield Executed(code, arguments)


def _by_lengths(data: bytes) -> Iterator[Executed]:
    pos = data.find(b"\x01")
    while 0 <= pos <= len(data) - _SMALLEST:
        length, code, argc = struct.unpack_from("<xI4xIH", data, pos)
        stop = pos + length
        call = None
        if _SMALLEST <= length <= len(data) - pos and data[stop - 1] == 4:
            call = _cut_by_lengths(data[pos + _HEADER : stop - 1], argc, code)
        if call is not None:
            yield call
        pos = data.find(b"\x01", pos + 1 if call is None else stop)


def _cut_by_lengths(body: bytes, argc: int, code: int) -> Executed | None:
    pos = 0
    arguments: list[Plain] = []
    for _ in range(argc):
        if len(body) - pos < 4:
            return None
        stop = pos + 4 + int.from_bytes(body[pos : pos + 4], "little")
        values = _arguments(body[pos:stop], 1) if stop <= len(body) else None
        if values is None:
            return None
        arguments += values
        pos = stop
    return Executed(code, tuple(arguments))


def _arguments(body: bytes, argc: int) -> tuple[Plain, ...] | None:
    pos, values = 0, []
    try:
        for _ in range(argc):
            value, pos = _value(body, pos + 4)
            values.append(value)
    except (struct.error, ValueError):
        return None
    return tuple(values)


def _value(body: bytes, pos: int) -> tuple[Plain, int]:
    vt, count = struct.unpack_from("<HI", body, pos)
    pos += 6
    if not vt & _ARRAY:
        return _element(body, pos, vt)
    base = vt & ~_ARRAY
    if count > len(body):
        raise ValueError
    items: list[Plain] = []
    for _ in range(count):
        item, pos = _value(body, pos) if base == _VARIANT else _element(body, pos, base)
        items.append(item)
    return tuple(items), pos


def _element(body: bytes, pos: int, base: int) -> tuple[Plain, int]:
    if base == _BSTR:
        (size,) = struct.unpack_from("<I", body, pos)
        stop = pos + 4 + size
        if stop > len(body):
            raise ValueError
        return body[pos + 4 : stop - size % 2].decode("utf-16-le", "replace"), stop
    if base not in _WIDTHS:  # C takes an unknown type without data
        return None, pos
    (number,) = struct.unpack_from(f"<{_WIDTHS[base]}", body, pos)
    return number, pos + struct.calcsize(_WIDTHS[base])


def _nth(values: tuple[Plain, ...], index: int) -> Plain:
    return values[index] if index < len(values) else None
