"""Find the position and meaning of each field of a frame, for the tree of fields on the screen."""

from __future__ import annotations

import sys
from bisect import bisect_left
from collections.abc import Container, Iterator, Sequence
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
from bcapscope.protocol.tables.command_catalogue import command_name
from bcapscope.protocol.tables.function_table import (
    function_name,
    request_param,
    result_param,
    signed_function_id,
)
from bcapscope.protocol.tables.hresult import hresult_name

HRESULT = "HRESULT"

UNREAD = "unread"
"""Name of the field for the unreadable rest of an argument."""

_TYPE_AND_COUNT = 6
_COMPRESSED_AT = 13  # offset of the compressed bytes in a version 1 frame
# after a problem with one of these codes, the rest of the argument is unreadable
_READING_ENDED = frozenset({"data", "type", "nesting", "elements"})


@dataclass(frozen=True, slots=True)
class FrameField:
    """A range of a frame's bytes, with its name and meaning.

    Attributes:
        stop: Offset after the field's last byte; equal to `start` if the frame lacks the field.
        value: None if the field has no value or its value is unreadable.
        vt: VARIANT type of `value`; None for numbers of the header.
        text: Meaning of the value, such as `Robot_Execute` or `VT_I4`; empty if unknown.
        problems: Problems of this field and its children, in the order of their offsets.
        children: Fields that together cover this field without a gap.
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
    """Return the fields of a frame, from SOH to EOT. The offsets of the fields refer to `Frame.body`.

    Every byte belongs to exactly one field without children, even in a damaged frame. If EOT is missing, its
    field has no bytes; if EOT is damaged, its field has the damaged byte. For a reply, `function_id` and
    `command` come from the request; both are None if the request was not captured.
    """
    if is_request:
        function_id, command = frame.code, command_name(frame.code, frame.variants)
    problems = [each for each in frame.problems if not _is_in_envelope(each, frame)]
    return tuple(_FieldBuilder(frame, problems).all_fields(is_request, function_id, command))


def envelope_fields(frame: Frame) -> tuple[FrameField, ...]:
    """Return the fields of `Frame.raw` for a compressed frame; () for any other frame.

    keioku/bcap-python defines the layout: the usual header up to `reserved`, then the unpacked size, a zlib
    stream, a mode byte and EOT.
    """
    if frame.framing is not Framing.VERSION_1_ZLIB:
        return ()
    raw = frame.raw
    problems = [
        each for each in frame.problems if each.code in ("soh", "length") or _is_in_envelope(each, frame)
    ]
    walk = _FieldBuilder(frame, problems, raw)
    end = len(raw) - 2
    return (
        *walk.header_fields(),
        walk.number_field("unpacked size", 9, _COMPRESSED_AT),
        walk.field("compressed", _COMPRESSED_AT, end, raw[_COMPRESSED_AT:end], text="zlib"),
        walk.number_field("mode byte", end, end + 1),
        walk.field("EOT", end + 1, end + 2),
    )


def _is_in_envelope(problem: Problem, frame: Frame) -> bool:
    """Return whether a problem of a compressed frame concerns its compressed bytes. Apart from the external
    problem, only such problems have offsets from 9 to the end of the header. These offsets refer to
    `Frame.raw`, while the offsets of problems in the arguments refer to the unpacked body.
    """
    return 9 <= problem.offset < HEADER_SIZE and problem is not frame.external_problem


class _FieldBuilder:
    def __init__(self, frame: Frame, problems: list[Problem], body: bytes | None = None) -> None:
        self._frame = frame
        self.body = frame.body if body is None else body
        self._argc_problems = tuple(each for each in problems if each.code == "argc")
        self._eot_problems = tuple(each for each in problems if each.code == "eot")
        stops = {argument.stop for argument in frame.arguments} if problems else set()
        self._placed = sorted(
            (_doubled_place(each, stops), each) for each in problems if each.code not in ("argc", "eot")
        )
        self._argument_stop = 0  # of the current argument

    def all_fields(
        self, is_request: bool, function_id: int | None, command: str | None
    ) -> Iterator[FrameField]:
        frame = self._frame
        yield from self.header_fields()
        if is_request:
            code = signed_function_id(frame.code)
            yield self.field("function id", 9, 13, code, text=function_name(code))
        else:
            yield self.field(HRESULT, 9, 13, frame.code, text=hresult_name(frame.code))
        yield self.field("argument count", 13, HEADER_SIZE, frame.argc, problems=self._argc_problems)
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
        yield self.field("SOH", 0, 1)
        for name, start, stop in (("length", 1, 5), ("serial", 5, 7), ("reserved", 7, 9)):
            yield self.number_field(name, start, stop)

    def number_field(self, name: str, start: int, stop: int) -> FrameField:
        return self.field(name, start, stop, int.from_bytes(self.body[start:stop], "little"))

    def field(
        self,
        name: str,
        start: int,
        stop: int,
        value: Value = None,
        vt: int | None = None,
        *,
        text: str | Message = "",
        unit: str = "",
        problems: tuple[Problem, ...] = (),
        children: Sequence[FrameField] = (),
    ) -> FrameField:
        """Return a field. The parameter `problems` is added to the problems in the field's byte range."""
        found = (*self.problems_within(start, stop), *problems)
        return FrameField(name, start, stop, value, vt, text, unit, found, children)

    def problems_within(self, start: int, stop: int) -> tuple[Problem, ...]:
        """Return the problems at offsets `start` to `stop` - 1. A truncation of the argument that ends at
        `start` also has the offset `start`, but belongs to that argument, and is not returned.
        """
        return self.problems_between(2 * start, 2 * stop - 1)

    def problems_between(self, first: int, behind: int) -> tuple[Problem, ...]:
        """Return each problem whose sort key is from `first` to `behind` - 1. For the key, see
        `_doubled_place`.
        """
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
            if name is None:
                yield self.field("left over", start, end, body[start:end])
            else:
                yield self.number_field(name, start, end)
        beyond = self.problems_between(2 * size, sys.maxsize)
        yield self.field("EOT", end, size, problems=(*self._eot_problems, *beyond))

    def _argument_field(self, name: str, argument: Argument, label: ValueLabel) -> FrameField:
        variant, start, stop = argument
        self._argument_stop = stop
        parts = [
            self.number_field("length", start, start + 4),
            *self._variant_fields(variant, start + 4, label),
        ]
        problems = self.problems_between(2 * start, 2 * stop)
        if any(each.code in _READING_ENDED for each in problems):
            end, broken = parts[-1].stop, self.problems_between(2 * stop - 1, 2 * stop)
            if end < stop or broken:
                parts.append(self.field(UNREAD, end, stop, self.body[end:stop] or None, problems=broken))
        return FrameField(name, start, stop, variant.value, variant.vt, label.text, "", problems, parts)

    def _variant_fields(self, variant: Variant, start: int, label: ValueLabel) -> Iterator[FrameField]:
        vt, value = variant.vt, variant.value
        yield self.field("type", start, start + 2, vt, text=vt_name(vt))
        yield self.number_field("element count", start + 2, start + _TYPE_AND_COUNT)
        start += _TYPE_AND_COUNT
        if isinstance(value, tuple) and value:
            parts = self._element_fields(vt & ~ARRAY, value, start, label.elements)
            yield self.field("data", start, parts[-1].stop, value, vt, children=parts)
        elif isinstance(value, str):
            yield self._string_field("data", start, value)
        elif value is not None and value not in ((), b""):
            size = len(value) if isinstance(value, bytes) else NUMBER_WIDTHS[vt]
            yield self.field("data", start, start + size, value, vt, unit=label.unit)

    def _element_fields(
        self, base: int, values: tuple[object, ...], start: int, labels: tuple[ValueLabel, ...]
    ) -> Sequence[FrameField]:
        if base in NUMBER_WIDTHS:
            return _NumberFields(self, base, values, start, labels)
        fields: list[FrameField] = []
        for index, value in enumerate(values):
            label = labels[index] if index < len(labels) else NO_LABEL
            if isinstance(value, Variant):
                fields.append(self._nested_field(label.name or f"[{index}]", start, value, label))
            elif isinstance(value, str):
                fields.append(self._string_field(f"[{index}]", start, value))
            start = fields[-1].stop
        return fields

    def _nested_field(self, name: str, start: int, variant: Variant, label: ValueLabel) -> FrameField:
        parts = list(self._variant_fields(variant, start, label))
        found = self.problems_within(start, parts[-1].stop)
        vt, value, _ = variant
        return FrameField(name, start, parts[-1].stop, value, vt, label.text, label.unit, found, parts)

    def _string_field(self, name: str, start: int, value: str) -> FrameField:
        middle = start + 4
        # a string may claim to be longer than its argument
        stop = min(middle + int.from_bytes(self.body[start:middle], "little"), self._argument_stop)
        parts = [self.number_field("bytes", start, middle)]
        if middle < stop:
            parts.append(self.field("characters", middle, stop, value, VT.BSTR))
        return self.field(name, start, stop, value, VT.BSTR, children=parts)


def _doubled_place(problem: Problem, stops: Container[int]) -> int:
    """Return a sort key for a problem: twice its offset, or one less if the problem truncates an argument.
    Such a problem has the offset at which the next argument begins, but the lower key assigns the problem to
    the truncated argument.
    """
    breaks_off = problem.code in ("data", "nesting", "elements") and problem.offset in stops
    return 2 * problem.offset - breaks_off


@dataclass(eq=False)
class _NumberFields(Sequence[FrameField]):
    """Fields of the elements of a number array; each field is created on access."""

    builder: _FieldBuilder
    base: int
    values: tuple[object, ...]
    start: int
    labels: tuple[ValueLabel, ...]

    def __len__(self) -> int:
        return len(self.values)

    @overload
    def __getitem__(self, index: int) -> FrameField: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[FrameField]: ...
    def __getitem__(self, index: int | slice) -> FrameField | Sequence[FrameField]:
        if isinstance(index, slice):
            return tuple(self._field_at(each) for each in range(*index.indices(len(self.values))))
        return self._field_at(range(len(self.values))[index])

    def _field_at(self, index: int) -> FrameField:
        part = self.labels[index] if index < len(self.labels) else NO_LABEL
        width = NUMBER_WIDTHS[self.base]
        start = self.start + index * width
        stop = start + width
        value: Value = self.values[index]  # type: ignore[assignment]  # plain numbers
        name = part.name or f"[{index}]"
        return self.builder.field(name, start, stop, value, self.base, text=part.text, unit=part.unit)
