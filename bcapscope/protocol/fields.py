"""Where each field of a frame stands and what it is: for trees, hex views and everything that lights bytes.

The values were decoded by `bcapscope.protocol.arguments`; here they are only put beside their bytes.
"""

from __future__ import annotations

import sys
from bisect import bisect_left
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from dataclasses import field as member
from operator import itemgetter
from typing import overload

from bcapscope.protocol.arguments import Argument, Problem
from bcapscope.protocol.content import EOT, HEADER_SIZE, Framing
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import FUNCTIONS, function_name
from bcapscope.protocol.hresult import hresult_name
from bcapscope.protocol.meanings import argument_part, result_part
from bcapscope.protocol.parts import UNNAMED, Part, slv_move_part
from bcapscope.protocol.roles import request_role, result_role
from bcapscope.protocol.variant import ARRAY, NUMBER_WIDTHS, VT, Value, Variant, vt_name

HRESULT = "HRESULT"
"""Name of the field that tells how a call ended."""

UNREAD = "unread"
"""Name of the bytes of an argument that its value does not account for."""

_TYPE_AND_COUNT = 6
_ENVELOPE = 13  # compressed bytes of a version 1 frame begin here
_LOSSES = frozenset({"data", "type", "nesting", "elements"})  # problems that end the reading of an argument


@dataclass(frozen=True, slots=True)
class Field:
    """A run of bytes with a meaning.

    Attributes:
        name: of the header field, the argument or the element.
        start: offset of its first byte.
        stop: offset behind its last byte; equal to `start` where something is missing.
        value: what it holds; None where there is nothing to say or it could not be read.
        vt: type of `value` where that is typed by a VARIANT; None for the numbers of the frame itself.
        text: what the value stands for, such as `Robot_Execute` or `VT_I4`; else empty.
        unit: `mm`, `deg`, or empty.
        problems: what is wrong with it or inside of it, in the order of the bytes.
        children: fields that it consists of, which cover it without a gap; made only when looked at, so that
            an array of a million elements costs nothing before.
    """

    name: str
    start: int
    stop: int
    value: Value = None
    vt: int | None = None
    text: str = ""
    unit: str = ""
    problems: tuple[Problem, ...] = ()
    children: Sequence[Field] = member(default=(), compare=False, repr=False)


def fields(
    frame: Frame, is_request: bool, function_id: int | None = None, command: str | None = None
) -> tuple[Field, ...]:
    """Take a frame apart, from SOH to EOT; the offsets are those of `Frame.body`.

    Any frame, however damaged: the leaves cover every byte once. A missing EOT is a field without bytes, a
    damaged one has the byte that stands in its place.
    What a compressed frame looks like on the wire is in `envelope`, with the problems that belong there.

    Args:
        frame: the frame.
        is_request: who sent it; nothing in the frame tells.
        function_id: for a reply, of the request that it answers, where that was seen.
        command: for a reply, that request's bstrCommand, where it has one.
    """
    if is_request:
        function_id, command = frame.code, _command(frame)
    hidden = _of_envelope(frame)
    return tuple(
        _Walk(frame, [each for each in frame.problems if each not in hidden]).frame(
            is_request, function_id, command
        )
    )


def envelope(frame: Frame) -> tuple[Field, ...]:
    """Return the fields of `Frame.raw` for a compressed frame; () for all others.

    Version 1 as in keioku/bcap-python: header as ever up to `reserved`, then the unpacked size, a zlib
    stream, a mode byte and EOT.
    """
    if frame.framing is not Framing.VERSION_1_ZLIB:
        return ()
    raw = frame.raw
    head = [each for each in frame.problems if each.code in ("soh", "length")]
    walk = _Walk(frame, head + _of_envelope(frame), raw)
    end = len(raw) - 2
    return (
        *walk.header(),
        walk.number("unpacked size", 9, _ENVELOPE),
        walk.leaf("compressed", _ENVELOPE, end, raw[_ENVELOPE:end], text="zlib"),
        walk.number("mode byte", end, end + 1),
        walk.leaf("EOT", end + 1, end + 2),
    )


def _of_envelope(frame: Frame) -> list[Problem]:
    """Return the problems of a compressed frame whose offsets mean `Frame.raw`."""
    if frame.reserved != 1 or frame.framing is not Framing.VERSION_1_ZLIB:
        return []
    return [each for each in frame.problems if 9 <= each.offset < HEADER_SIZE and each is not frame.note]


def _command(frame: Frame) -> str | None:
    params = FUNCTIONS[frame.code].params if frame.code in FUNCTIONS else ()
    arguments = frame.arguments
    if len(params) < 2 or params[1].name != "bstrCommand" or len(arguments) < 2:
        return None
    value = arguments[1].variant.value
    return value if isinstance(value, str) else None


class _Walk:
    """Puts decoded values beside the bytes of one frame."""

    def __init__(self, frame: Frame, problems: list[Problem], body: bytes | None = None) -> None:
        self._frame = frame
        self.body = frame.body if body is None else body
        self._argc_problems = tuple(each for each in problems if each.code == "argc")
        self._eot_problems = tuple(each for each in problems if each.code == "eot")
        stops = {argument.stop for argument in frame.arguments} if problems else set()
        self._placed = sorted(
            (_place(each, stops), each) for each in problems if each.code not in ("argc", "eot")
        )

    def frame(self, is_request: bool, function_id: int | None, command: str | None) -> Iterator[Field]:
        """Yield the fields of the frame in the order of its bytes."""
        frame = self._frame
        yield from self.header()
        name, text = ("function id", function_name) if is_request else (HRESULT, hresult_name)
        yield self.leaf(name, 9, 13, frame.code, text=text(frame.code))
        yield self.leaf("argument count", 13, HEADER_SIZE, frame.argc, problems=self._argc_problems)
        role, meaning = (request_role, argument_part) if is_request else (result_role, result_part)
        moves = command is not None and command.casefold() == "slvmove"
        pos = HEADER_SIZE
        for index, argument in enumerate(frame.arguments):
            name = role(function_id, index).name
            if moves and index == (2 if is_request else 0):
                part = slv_move_part(argument.variant, is_request)
            else:
                part = meaning(function_id, command, name, argument.variant)
            yield self._argument(name, argument, part)
            pos = argument.stop
        yield from self._tail(pos)

    def header(self) -> Iterator[Field]:
        """Yield what stands before the function id or HRESULT."""
        yield self.leaf("SOH", 0, 1)
        for name, start, stop in (("length", 1, 5), ("serial", 5, 7), ("reserved", 7, 9)):
            yield self.number(name, start, stop)

    def number(self, name: str, start: int, stop: int) -> Field:
        """Make a field of an unsigned number."""
        return self.leaf(name, start, stop, int.from_bytes(self.body[start:stop], "little"))

    def leaf(
        self,
        name: str,
        start: int,
        stop: int,
        value: Value = None,
        *,
        text: str = "",
        problems: tuple[Problem, ...] = (),
    ) -> Field:
        """Make a field without children; `problems` come on top of those that its bytes have."""
        return Field(name, start, stop, value, None, text, "", (*self.within(start, stop), *problems))

    def within(self, start: int, stop: int) -> tuple[Problem, ...]:
        """Return the problems of some bytes, without that of a value that breaks off behind them."""
        return self.between(2 * start, 2 * stop - 1)

    def between(self, first: int, behind: int) -> tuple[Problem, ...]:
        """Return the problems whose places, see `_place`, are in a range."""
        placed = self._placed
        if not placed:
            return ()
        start, stop = (bisect_left(placed, place, key=itemgetter(0)) for place in (first, behind))
        return tuple(problem for _, problem in placed[start:stop])

    def _tail(self, start: int) -> Iterator[Field]:
        body = self.body
        size = len(body)
        # A last byte that is none is taken for a damaged EOT where the length says that the frame ends there.
        has_eot = body[-1] == EOT or int.from_bytes(body[1:5], "little") == size
        end = size - 1 if size > HEADER_SIZE and has_eot else size
        if start < end:
            name = {Framing.SERIAL_LINE: "CRC", Framing.VERSION_1: "mode byte"}.get(self._frame.framing)
            yield (
                self.number(name, start, end) if name else self.leaf("left over", start, end, body[start:end])
            )
        beyond = self.between(2 * size, sys.maxsize)
        yield self.leaf("EOT", end, size, problems=(*self._eot_problems, *beyond))

    def _argument(self, name: str, argument: Argument, part: Part) -> Field:
        variant, start, stop = argument
        problems = self.between(2 * start, 2 * stop)
        parts = _Made(lambda: _Inside(self, argument).fields(part))
        return Field(name, start, stop, variant.value, variant.vt, part.text, "", problems, parts)


class _Inside:
    """Puts the value of one argument beside its bytes."""

    def __init__(self, walk: _Walk, argument: Argument) -> None:
        self._walk = walk
        self._argument = argument

    def fields(self, part: Part) -> Iterator[Field]:
        """Yield the fields that the argument consists of, in the order of its bytes."""
        variant, start, stop = self._argument
        walk = self._walk
        yield walk.number("length", start, start + 4)
        yield from self._variant_parts(variant, start + 4, part)
        if any(each.code in _LOSSES for each in walk.between(2 * start, 2 * stop)):
            end = self._end(variant, start + 4)
            broken = walk.between(2 * stop - 1, 2 * stop)
            if end < stop or broken:
                yield walk.leaf(UNREAD, end, stop, walk.body[end:stop] or None, problems=broken)

    def _variant_parts(self, variant: Variant, start: int, part: Part) -> Iterator[Field]:
        """Yield type, count and data of a VARIANT that begins at `start`."""
        yield self._walk.leaf("type", start, start + 2, variant.vt, text=vt_name(variant.vt))
        yield self._walk.number("element count", start + 2, start + _TYPE_AND_COUNT)
        start += _TYPE_AND_COUNT
        vt, value = variant.vt, variant.value
        if isinstance(value, tuple) and value:
            stop = self._data_end(variant, start)
            parts = self._elements(vt & ~ARRAY, value, start, part.parts)
            yield Field("data", start, stop, value, vt, "", "", self._walk.within(start, stop), parts)
        elif isinstance(value, str):
            yield self._string("data", start, value)
        elif value is not None and value not in ((), b""):
            stop = self._data_end(variant, start)
            yield Field("data", start, stop, value, vt, "", part.unit, self._walk.within(start, stop))

    def _elements(
        self, base: int, values: tuple[object, ...], start: int, parts: tuple[Part, ...]
    ) -> Sequence[Field]:
        if base in NUMBER_WIDTHS:
            return _Numbers(self._walk, base, values, start, parts)
        if base == VT.BSTR:
            return _Made(lambda: self._strings(values, start))
        return _Made(lambda: self._variants(values, start, parts))

    def _strings(self, values: tuple[object, ...], start: int) -> Iterator[Field]:
        for index, value in enumerate(values):
            if isinstance(value, str):
                yield self._string(f"[{index}]", start, value)
                start = self._string_end(start)

    def _string(self, name: str, start: int, value: str) -> Field:
        middle, stop = start + 4, self._string_end(start)
        parts = _Made(lambda: self._string_parts(start, middle, stop, value))
        return Field(name, start, stop, value, VT.BSTR, "", "", self._walk.within(start, stop), parts)

    def _string_parts(self, start: int, middle: int, stop: int, value: str) -> Iterator[Field]:
        yield self._walk.number("bytes", start, middle)
        if middle < stop:
            yield Field("characters", middle, stop, value, VT.BSTR, "", "", self._walk.within(middle, stop))

    def _variants(self, values: tuple[object, ...], start: int, parts: tuple[Part, ...]) -> Iterator[Field]:
        for index, variant in enumerate(values):
            if isinstance(variant, Variant):
                part = parts[index] if index < len(parts) else UNNAMED
                yield self._element(part.name or f"[{index}]", variant, start, part)
                start = self._end(variant, start)

    def _element(self, name: str, variant: Variant, start: int, part: Part) -> Field:
        stop = self._end(variant, start)
        parts = _Made(lambda: self._variant_parts(variant, start, part))
        problems = self._walk.within(start, stop)
        return Field(name, start, stop, variant.value, variant.vt, part.text, part.unit, problems, parts)

    def _end(self, variant: Variant, start: int) -> int:
        """Return the offset behind the last byte of a VARIANT's value, where it was read to."""
        return self._data_end(variant, start + _TYPE_AND_COUNT)

    def _data_end(self, variant: Variant, start: int) -> int:
        value, base = variant.value, variant.vt & ~ARRAY
        if value is None:
            return start
        if isinstance(value, bytes):
            return start + len(value)
        values = value if isinstance(value, tuple) else (value,)
        if base in NUMBER_WIDTHS:
            return start + len(values) * NUMBER_WIDTHS[base]
        for each in values:
            if isinstance(each, Variant):
                start = self._end(each, start)
            elif isinstance(each, str):
                start = self._string_end(start)
        return start

    def _string_end(self, start: int) -> int:
        """Return the offset behind a string, which its argument may cut short."""
        size = int.from_bytes(self._walk.body[start : start + 4], "little")
        return min(start + 4 + size, self._argument.stop)


def _place(problem: Problem, stops: Container[int]) -> int:
    """Return twice the offset of a problem, one less for a value that breaks off where its argument ends."""
    breaks_off = problem.code in ("data", "nesting", "elements") and problem.offset in stops
    return 2 * problem.offset - breaks_off


class _Numbers(Sequence[Field]):
    """The elements of an array of fixed width, each made when it is looked at."""

    def __init__(
        self, walk: _Walk, base: int, values: tuple[object, ...], start: int, parts: tuple[Part, ...]
    ) -> None:
        self._walk = walk
        self._base = base
        self._values = values
        self._start = start
        self._parts = parts

    def __len__(self) -> int:
        return len(self._values)

    @overload
    def __getitem__(self, index: int) -> Field: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Field]: ...
    def __getitem__(self, index: int | slice) -> Field | Sequence[Field]:
        if isinstance(index, slice):
            return tuple(self._made(each) for each in range(*index.indices(len(self._values))))
        return self._made(range(len(self._values))[index])

    def _made(self, index: int) -> Field:
        part = self._parts[index] if index < len(self._parts) else UNNAMED
        width = NUMBER_WIDTHS[self._base]
        start = self._start + index * width
        stop = start + width
        value: Value = self._values[index]  # type: ignore[assignment]  # plain numbers
        problems = self._walk.within(start, stop)
        return Field(
            part.name or f"[{index}]", start, stop, value, self._base, part.text, part.unit, problems
        )


class _Made(Sequence[Field]):
    """Fields that are found one after the other, kept only where one of them is asked for by its place."""

    def __init__(self, make: Callable[[], Iterator[Field]]) -> None:
        self._make = make
        self._kept: tuple[Field, ...] | None = None

    def __iter__(self) -> Iterator[Field]:
        return self._make() if self._kept is None else iter(self._kept)

    def __bool__(self) -> bool:
        return next(iter(self), None) is not None

    def __len__(self) -> int:
        return len(self._all())

    @overload
    def __getitem__(self, index: int) -> Field: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Field]: ...
    def __getitem__(self, index: int | slice) -> Field | Sequence[Field]:
        return self._all()[index]

    def _all(self) -> tuple[Field, ...]:
        if self._kept is None:
            self._kept = tuple(self._make())
        return self._kept
