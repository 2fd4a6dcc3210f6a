"""The fields of a frame as rows of a tree: offset, depth, name and meaning of every field."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from itertools import islice
from typing import NamedTuple

from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Malformed
from bcapscope.protocol.codec.variant import vt_name
from bcapscope.protocol.dissection.frame_field import HRESULT, FrameField, envelope_fields, frame_fields
from bcapscope.protocol.tables.hresult import describe_hresult, is_failure
from bcapscope.render.escape import printable
from bcapscope.render.value_text import LONGEST_STRING, value_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Observation

MAX_ELEMENTS = 32
"""By default, the rows of an array show at most this many elements."""


class FieldRowKind(Enum):
    FIELD = "field"
    """A field that consists of other fields. The rows of these fields follow."""
    LEAF = "leaf"
    """A field that contains bytes and no other fields."""
    PROBLEM = "problem"
    """A problem with the bytes of the field in the row above."""
    NOTE = "note"
    """A remark about the field in the row above. A remark has no bytes."""


class FieldRow(NamedTuple):
    """A row of the tree.

    `start` and `stop` are offsets in the body of the section. `name` and `text` are escaped. If the field is
    an HRESULT, `failed` says whether it means failure. For other fields, `failed` is None.
    """

    kind: FieldRowKind
    depth: int
    start: int
    stop: int
    name: str
    text: str
    failed: bool | None = None


class FrameSection(NamedTuple):
    """A part of the tree: bytes, their fields and an optional caption. The offsets of the fields count from
    the start of `body`."""

    caption: Message | None
    body: bytes
    fields: tuple[FrameField, ...]


def frame_sections(observation: Observation, call_kind: CallKind | None) -> tuple[FrameSection, ...]:
    """Return the sections of a frame or of malformed bytes: two for a compressed frame, otherwise one."""
    item = observation.item
    if isinstance(item, Malformed):
        # Malformed bytes have no fields. A gap in a stream does not even have bytes. Show only the problem.
        size = len(item.raw)
        name, value = ("bytes", item.raw) if size else ("no bytes", None)
        return (FrameSection(None, item.raw, (FrameField(name, 0, size, value, problems=item.problems),)),)
    is_request = observation.flow.direction is Direction.REQUEST
    function_id, command = call_kind or (None, None)
    whole = frame_fields(item, is_request, function_id, command)
    wire = envelope_fields(item)
    if not wire:
        return (FrameSection(None, item.raw, whole),)
    inner = FrameSection(Message("field.unpacked"), item.body, whole[4:-1])
    return (FrameSection(None, item.raw, wire), inner)


def field_rows(
    section: FrameSection, full: bool = False, words: MessageFormatter = ENGLISH_WORDS
) -> Iterator[FieldRow]:
    """Yield the rows of a section lazily, in the order of the bytes.

    With `full`, the rows show strings and arrays completely.
    """
    for field in section.fields:
        yield from _rows_of_field(field, 0, full, words)


def _rows_of_field(field: FrameField, depth: int, full: bool, words: MessageFormatter) -> Iterator[FieldRow]:
    kind = FieldRowKind.FIELD if field.children else FieldRowKind.LEAF
    failed = is_failure(field.value) if field.name == HRESULT and isinstance(field.value, int) else None
    text = field_meaning(field, None if full else LONGEST_STRING, words)
    yield FieldRow(kind, depth, field.start, field.stop, field.name, text, failed)
    if kind is FieldRowKind.LEAF:
        yield from _rows_of_problems(field.start, field.stop, field.problems, depth, words)
    yield from _rows_of_children(field, depth + 1, full, words)
    if failed is not None and isinstance(field.value, int):
        found = describe_hresult(field.value)
        for note in filter(None, (found.advice, Message("hresult.guess") if found.is_guess else None)):
            yield FieldRow(FieldRowKind.NOTE, depth + 1, field.start, field.start, "", words.text(note))


def _rows_of_children(
    field: FrameField, depth: int, full: bool, words: MessageFormatter
) -> Iterator[FieldRow]:
    count = len(field.value) if isinstance(field.value, tuple) and field.name == "data" else 0
    if full or count <= MAX_ELEMENTS:
        for child in field.children:
            yield from _rows_of_field(child, depth, full, words)
        return
    start = field.start
    for child in islice(field.children, MAX_ELEMENTS):
        yield from _rows_of_field(child, depth, full, words)
        start = child.stop
    more = words("field.more", n=count - MAX_ELEMENTS)
    yield FieldRow(FieldRowKind.LEAF, depth, start, field.stop, more, "")
    for problem in field.problems:
        if problem.offset >= start:
            yield from _rows_of_problems(problem.offset, problem.offset + 1, (problem,), depth, words)


def _rows_of_problems(
    start: int, stop: int, problems: Iterable[Problem], depth: int, words: MessageFormatter
) -> Iterator[FieldRow]:
    for problem in problems:
        yield FieldRow(FieldRowKind.PROBLEM, depth, start, stop, "", printable(words.text(problem.reason)))


def field_meaning(
    field: FrameField, longest: int | None = LONGEST_STRING, words: MessageFormatter = ENGLISH_WORDS
) -> str:
    """Return the meaning of a field in one line, or "" if the name of the field says everything.

    A string is cut after `longest` characters.
    """
    if field.vt is None:
        text = _frame_field_meaning(field, words)
    else:
        text = _variant_meaning(field, field.vt, longest, words)
    if field.unit:
        text += f" {field.unit}"
    return f"{text}, {words.place_text(field.text, '')}" if field.text and field.vt is not None else text


def _frame_field_meaning(field: FrameField, words: MessageFormatter) -> str:
    value = field.value
    if isinstance(value, bytes):
        return words.plural("count.byte", len(value)) + (f", {field.text}" if field.text else "")
    if field.name == "type" or value is None:
        return str(field.text)
    if field.name == HRESULT and isinstance(value, int):
        return f"{field.text}, {words.text(describe_hresult(value).meaning)}"
    return f"{value} {field.text}".rstrip()


def _variant_meaning(field: FrameField, vt: int, longest: int | None, words: MessageFormatter) -> str:
    """Describe the value of a VARIANT. Add the type of the VARIANT if the field includes the bytes of the
    type."""
    value = field.value
    text = value_text(value, vt, longest, words)
    if isinstance(value, tuple):
        text = words.plural("count.element", len(value))
    elif isinstance(value, bytes):
        text = words.plural("count.byte", len(value))
    if field.name == "data" and isinstance(value, str):
        return ""  # its characters come next
    has_type = any(child.name == "type" for child in islice(field.children, 2))
    return f"{vt_name(vt)} {text}".rstrip() if has_type else text
