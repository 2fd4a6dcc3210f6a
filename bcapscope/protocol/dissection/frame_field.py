"""Finds the position and meaning of each field of a frame. The screen shows these fields as a tree, and
highlights their bytes.

`bcapscope.protocol.codec.arguments` decodes the values; this module finds the bytes of each value.
"""

from __future__ import annotations

import sys
from bisect import bisect_left
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from dataclasses import field as member
from operator import itemgetter
from typing import overload

from bcapscope.messages import Message
from bcapscope.protocol.codec.arguments import Argument, Problem
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_content import EOT, HEADER_SIZE, Framing
from bcapscope.protocol.codec.variant import ARRAY, NUMBER_WIDTHS, VT, Value, Variant, vt_name
from bcapscope.protocol.dissection.value_labels import (
    NO_LABEL,
    ValueLabel,
    argument_label,
    result_label,
    slvmove_label,
)
from bcapscope.protocol.tables.function_table import (
    FUNCTIONS,
    function_name,
    request_param,
    result_param,
    signed_function_id,
)
from bcapscope.protocol.tables.hresult import hresult_name

HRESULT = "HRESULT"
"""Name of the field that holds the result code of a call."""

UNREAD = "unread"
"""Name of the field for superfluous bytes: bytes of an argument that do not belong to the argument's
value.
"""

_TYPE_AND_COUNT = 6
_COMPRESSED_AT = 13  # offset of the compressed bytes in a version 1 frame
_READING_ENDED = frozenset(
    {"data", "type", "nesting", "elements"}
)  # after a problem with one of these codes, the rest of the argument is unreadable


@dataclass(frozen=True, slots=True)
class FrameField:
    """A range of a frame's bytes, with its name and meaning.

    Attributes:
        name: Name of the header field, argument or element.
        start: Offset of the field's first byte.
        stop: Offset after the field's last byte; equal to `start` if the frame lacks the field.
        value: Value of the field; None if the field has no value or its value is unreadable.
        vt: VARIANT type of `value`; None for numbers of the header.
        text: Meaning of the value, such as `Robot_Execute` or `VT_I4`; empty if unknown.
        unit: Unit of the value: `mm`, `deg`, or empty.
        problems: Problems of this field and its children, in the order of their offsets.
        children: Fields that together cover this field without a gap. Children are created on access, so even
            a large array costs nothing until its elements are displayed.
    """

    name: str
    start: int
    stop: int
    value: Value = None
    vt: int | None = None
    text: str | Message = ""
    unit: str = ""
    problems: tuple[Problem, ...] = ()
    children: Sequence[FrameField] = member(default=(), compare=False, repr=False)


def frame_fields(
    frame: Frame, is_request: bool, function_id: int | None = None, command: str | None = None
) -> tuple[FrameField, ...]:
    """Return the fields of a frame, from SOH to EOT. Their offsets refer to `Frame.body`.

    The fields without children together cover every byte exactly once, even in a damaged frame. If EOT is
    missing, its field has no bytes; if EOT is damaged, its field has the damaged byte. For a compressed
    frame, this function returns the fields of the unpacked content; `envelope_fields` returns the fields on
    the wire.

    For a reply, `function_id` and `command` come from the request; both are None if the request was not
    captured.
    """
    if is_request:
        function_id, command = frame.code, _command_of(frame)
    hidden = _envelope_problems(frame)
    return tuple(
        _FieldBuilder(frame, [each for each in frame.problems if each not in hidden]).all_fields(
            is_request, function_id, command
        )
    )


def envelope_fields(frame: Frame) -> tuple[FrameField, ...]:
    """Return the fields of `Frame.raw` for a compressed frame; () for any other frame.

    keioku/bcap-python defines the layout: the usual header up to `reserved`, then the unpacked size, a zlib
    stream, a mode byte and EOT.
    """
    if frame.framing is not Framing.VERSION_1_ZLIB:
        return ()
    raw = frame.raw
    head = [each for each in frame.problems if each.code in ("soh", "length")]
    walk = _FieldBuilder(frame, head + _envelope_problems(frame), raw)
    end = len(raw) - 2
    return (
        *walk.header_fields(),
        walk.number_field("unpacked size", 9, _COMPRESSED_AT),
        walk.leaf_field("compressed", _COMPRESSED_AT, end, raw[_COMPRESSED_AT:end], text="zlib"),
        walk.number_field("mode byte", end, end + 1),
        walk.leaf_field("EOT", end + 1, end + 2),
    )


def _envelope_problems(frame: Frame) -> list[Problem]:
    """Return the problems of a compressed frame that have offsets in `Frame.raw`."""
    if frame.reserved != 1 or frame.framing is not Framing.VERSION_1_ZLIB:
        return []
    return [
        each
        for each in frame.problems
        if 9 <= each.offset < HEADER_SIZE and each is not frame.external_problem
    ]


def _command_of(frame: Frame) -> str | None:
    params = FUNCTIONS[frame.code].params if frame.code in FUNCTIONS else ()
    arguments = frame.arguments
    if len(params) < 2 or params[1].name != "bstrCommand" or len(arguments) < 2:
        return None
    value = arguments[1].variant.value
    return value if isinstance(value, str) else None


class _FieldBuilder:
    """Builds the fields of one frame from its decoded values."""

    def __init__(self, frame: Frame, problems: list[Problem], body: bytes | None = None) -> None:
        self._frame = frame
        self.body = frame.body if body is None else body
        self._argc_problems = tuple(each for each in problems if each.code == "argc")
        self._eot_problems = tuple(each for each in problems if each.code == "eot")
        stops = {argument.stop for argument in frame.arguments} if problems else set()
        self._placed = sorted(
            (_doubled_place(each, stops), each) for each in problems if each.code not in ("argc", "eot")
        )

    def all_fields(
        self, is_request: bool, function_id: int | None, command: str | None
    ) -> Iterator[FrameField]:
        frame = self._frame
        yield from self.header_fields()
        if is_request:
            code = signed_function_id(frame.code)
            yield self.leaf_field("function id", 9, 13, code, text=function_name(code))
        else:
            yield self.leaf_field(HRESULT, 9, 13, frame.code, text=hresult_name(frame.code))
        yield self.leaf_field("argument count", 13, HEADER_SIZE, frame.argc, problems=self._argc_problems)
        role, meaning = (request_param, argument_label) if is_request else (result_param, result_label)
        moves = command is not None and command.casefold() == "slvmove"
        pos = HEADER_SIZE
        for index, argument in enumerate(frame.arguments):
            name = role(function_id, index).name
            if moves and index == (2 if is_request else 0):
                part = slvmove_label(argument.variant, is_request)
            else:
                part = meaning(function_id, command, name, argument.variant)
            yield self._argument_field(name, argument, part)
            pos = argument.stop
        yield from self._tail_fields(pos)

    def header_fields(self) -> Iterator[FrameField]:
        """Yield the fields before the function id or HRESULT."""
        yield self.leaf_field("SOH", 0, 1)
        for name, start, stop in (("length", 1, 5), ("serial", 5, 7), ("reserved", 7, 9)):
            yield self.number_field(name, start, stop)

    def number_field(self, name: str, start: int, stop: int) -> FrameField:
        return self.leaf_field(name, start, stop, int.from_bytes(self.body[start:stop], "little"))

    def leaf_field(
        self,
        name: str,
        start: int,
        stop: int,
        value: Value = None,
        *,
        text: str = "",
        problems: tuple[Problem, ...] = (),
    ) -> FrameField:
        """Return a field without children. The problems of the field are the problems found in its bytes,
        followed by `problems`.
        """
        return FrameField(
            name, start, stop, value, None, text, "", (*self.problems_within(start, stop), *problems)
        )

    def problems_within(self, start: int, stop: int) -> tuple[Problem, ...]:
        """Return the problems in a byte range, but ignore a value that is truncated at the end of the
        range.
        """
        return self.problems_between(2 * start, 2 * stop - 1)

    def problems_between(self, first: int, behind: int) -> tuple[Problem, ...]:
        """Return the problems whose doubled offsets (see `_doubled_place`) are in a range."""
        placed = self._placed
        if not placed:
            return ()
        start, stop = (bisect_left(placed, place, key=itemgetter(0)) for place in (first, behind))
        return tuple(problem for _, problem in placed[start:stop])

    def _tail_fields(self, start: int) -> Iterator[FrameField]:
        body = self.body
        size = len(body)
        # A last byte other than EOT counts as a damaged EOT if the length field confirms the end.
        has_eot = body[-1] == EOT or int.from_bytes(body[1:5], "little") == size
        end = size - 1 if size > HEADER_SIZE and has_eot else size
        if start < end:
            name = {Framing.SERIAL_LINE: "CRC", Framing.VERSION_1: "mode byte"}.get(self._frame.framing)
            yield (
                self.number_field(name, start, end)
                if name
                else self.leaf_field("left over", start, end, body[start:end])
            )
        beyond = self.problems_between(2 * size, sys.maxsize)
        yield self.leaf_field("EOT", end, size, problems=(*self._eot_problems, *beyond))

    def _argument_field(self, name: str, argument: Argument, label: ValueLabel) -> FrameField:
        variant, start, stop = argument
        problems = self.problems_between(2 * start, 2 * stop)
        parts = _LazyFields(lambda: _ArgumentFields(self, argument).fields(label))
        return FrameField(name, start, stop, variant.value, variant.vt, label.text, "", problems, parts)


class _ArgumentFields:
    """Builds the fields of one argument from its decoded value."""

    def __init__(self, builder: _FieldBuilder, argument: Argument) -> None:
        self._builder = builder
        self._argument = argument

    def fields(self, label: ValueLabel) -> Iterator[FrameField]:
        variant, start, stop = self._argument
        walk = self._builder
        yield walk.number_field("length", start, start + 4)
        yield from self._variant_fields(variant, start + 4, label)
        if any(each.code in _READING_ENDED for each in walk.problems_between(2 * start, 2 * stop)):
            end = self._value_end(variant, start + 4)
            broken = walk.problems_between(2 * stop - 1, 2 * stop)
            if end < stop or broken:
                yield walk.leaf_field(UNREAD, end, stop, walk.body[end:stop] or None, problems=broken)

    def _variant_fields(self, variant: Variant, start: int, label: ValueLabel) -> Iterator[FrameField]:
        yield self._builder.leaf_field("type", start, start + 2, variant.vt, text=vt_name(variant.vt))
        yield self._builder.number_field("element count", start + 2, start + _TYPE_AND_COUNT)
        start += _TYPE_AND_COUNT
        vt, value = variant.vt, variant.value
        if isinstance(value, tuple) and value:
            stop = self._data_end(variant, start)
            parts = self._element_fields(vt & ~ARRAY, value, start, label.elements)
            yield FrameField(
                "data", start, stop, value, vt, "", "", self._builder.problems_within(start, stop), parts
            )
        elif isinstance(value, str):
            yield self._string_field("data", start, value)
        elif value is not None and value not in ((), b""):
            stop = self._data_end(variant, start)
            yield FrameField(
                "data", start, stop, value, vt, "", label.unit, self._builder.problems_within(start, stop)
            )

    def _element_fields(
        self, base: int, values: tuple[object, ...], start: int, labels: tuple[ValueLabel, ...]
    ) -> Sequence[FrameField]:
        if base in NUMBER_WIDTHS:
            return _NumberFields(self._builder, base, values, start, labels)
        if base == VT.BSTR:
            return _LazyFields(lambda: self._string_fields(values, start))
        return _LazyFields(lambda: self._nested_fields(values, start, labels))

    def _string_fields(self, values: tuple[object, ...], start: int) -> Iterator[FrameField]:
        for index, value in enumerate(values):
            if isinstance(value, str):
                yield self._string_field(f"[{index}]", start, value)
                start = self._string_end(start)

    def _string_field(self, name: str, start: int, value: str) -> FrameField:
        middle, stop = start + 4, self._string_end(start)
        parts = _LazyFields(lambda: self._fields_of_string(start, middle, stop, value))
        return FrameField(
            name, start, stop, value, VT.BSTR, "", "", self._builder.problems_within(start, stop), parts
        )

    def _fields_of_string(self, start: int, middle: int, stop: int, value: str) -> Iterator[FrameField]:
        yield self._builder.number_field("bytes", start, middle)
        if middle < stop:
            yield FrameField(
                "characters",
                middle,
                stop,
                value,
                VT.BSTR,
                "",
                "",
                self._builder.problems_within(middle, stop),
            )

    def _nested_fields(
        self, values: tuple[object, ...], start: int, labels: tuple[ValueLabel, ...]
    ) -> Iterator[FrameField]:
        for index, variant in enumerate(values):
            if isinstance(variant, Variant):
                part = labels[index] if index < len(labels) else NO_LABEL
                yield self._element_field(part.name or f"[{index}]", variant, start, part)
                start = self._value_end(variant, start)

    def _element_field(self, name: str, variant: Variant, start: int, label: ValueLabel) -> FrameField:
        stop = self._value_end(variant, start)
        parts = _LazyFields(lambda: self._variant_fields(variant, start, label))
        problems = self._builder.problems_within(start, stop)
        return FrameField(
            name, start, stop, variant.value, variant.vt, label.text, label.unit, problems, parts
        )

    def _value_end(self, variant: Variant, start: int) -> int:
        """Return the offset after the readable bytes of a VARIANT's value."""
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
                start = self._value_end(each, start)
            elif isinstance(each, str):
                start = self._string_end(start)
        return start

    def _string_end(self, start: int) -> int:
        """Return the offset after a string. If the string claims to be longer than its argument, return the
        offset after the argument.
        """
        size = int.from_bytes(self._builder.body[start : start + 4], "little")
        return min(start + 4 + size, self._argument.stop)


def _doubled_place(problem: Problem, stops: Container[int]) -> int:
    """Return twice a problem's offset, minus 1 if a value is truncated at the end of its argument."""
    breaks_off = problem.code in ("data", "nesting", "elements") and problem.offset in stops
    return 2 * problem.offset - breaks_off


class _NumberFields(Sequence[FrameField]):
    """Fields of the elements of a number array; each field is created on access."""

    def __init__(
        self,
        builder: _FieldBuilder,
        base: int,
        values: tuple[object, ...],
        start: int,
        labels: tuple[ValueLabel, ...],
    ) -> None:
        self._builder = builder
        self._base = base
        self._values = values
        self._start = start
        self._labels = labels

    def __len__(self) -> int:
        return len(self._values)

    @overload
    def __getitem__(self, index: int) -> FrameField: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[FrameField]: ...
    def __getitem__(self, index: int | slice) -> FrameField | Sequence[FrameField]:
        if isinstance(index, slice):
            return tuple(self._field_at(each) for each in range(*index.indices(len(self._values))))
        return self._field_at(range(len(self._values))[index])

    def _field_at(self, index: int) -> FrameField:
        part = self._labels[index] if index < len(self._labels) else NO_LABEL
        width = NUMBER_WIDTHS[self._base]
        start = self._start + index * width
        stop = start + width
        value: Value = self._values[index]  # type: ignore[assignment]  # plain numbers
        problems = self._builder.problems_within(start, stop)
        return FrameField(
            part.name or f"[{index}]", start, stop, value, self._base, part.text, part.unit, problems
        )


class _LazyFields(Sequence[FrameField]):
    """Fields that are created anew in each iteration. When a program first uses an index or the length, the
    fields are stored.
    """

    def __init__(self, make: Callable[[], Iterator[FrameField]]) -> None:
        self._make = make
        self._made: tuple[FrameField, ...] | None = None

    def __iter__(self) -> Iterator[FrameField]:
        return self._make() if self._made is None else iter(self._made)

    def __bool__(self) -> bool:
        return next(iter(self), None) is not None

    def __len__(self) -> int:
        return len(self._make_all())

    @overload
    def __getitem__(self, index: int) -> FrameField: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[FrameField]: ...
    def __getitem__(self, index: int | slice) -> FrameField | Sequence[FrameField]:
        return self._make_all()[index]

    def _make_all(self) -> tuple[FrameField, ...]:
        if self._made is None:
            self._made = tuple(self._make())
        return self._made
