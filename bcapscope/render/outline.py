"""A frame as rows: every field with its place, its depth, its name and its meaning.

What trees on paper and on screen share; how a row looks is theirs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from itertools import islice
from typing import NamedTuple

from bcapscope.protocol.arguments import Problem
from bcapscope.protocol.fields import HRESULT, Field, envelope, fields
from bcapscope.protocol.frame import Malformed
from bcapscope.protocol.hresult import describe, is_failure
from bcapscope.render.escape import printable
from bcapscope.render.meaning import LONGEST_STRING, meaning
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.question import Question

MOST_ELEMENTS = 32
"""Elements of an array that are shown unless all are asked for."""


class RowKind(Enum):
    """What a row is."""

    FIELD = "field"
    """A field that consists of others, which follow."""
    LEAF = "leaf"
    """A field with bytes of its own."""
    PROBLEM = "problem"
    """What is wrong with the bytes of the row."""
    NOTE = "note"
    """What there is to say about the row above; no bytes."""


class Row(NamedTuple):
    """One row.

    Attributes:
        kind: what it is.
        depth: 0 for the fields of the frame itself.
        start: offset of its first byte in the section.
        stop: offset behind its last byte.
        name: of the field; "" for problems and notes.
        text: what it means, harmless to terminals.
        failed: for an HRESULT, whether it is a failure; None for all else.
    """

    kind: RowKind
    depth: int
    start: int
    stop: int
    name: str
    text: str
    failed: bool | None = None


class Section(NamedTuple):
    """A run of bytes and the fields that stand in it.

    Attributes:
        caption: what stands above it; "" for nothing.
        body: the bytes that the offsets of the fields mean.
        fields: its fields.
    """

    caption: str
    body: bytes
    fields: tuple[Field, ...]


def sections(seen: Observation, question: Question | None) -> tuple[Section, ...]:
    """Take an item apart: one section, two for a compressed frame.

    Args:
        seen: the frame or malformed bytes.
        question: for a reply, the request that it answers, where that was seen.
    """
    item = seen.item
    if isinstance(item, Malformed):
        # Of a hole in a stream there is nothing but the problem to show.
        size = len(item.raw)
        name, value = ("bytes", item.raw) if size else ("no bytes", None)
        return (Section("", item.raw, (Field(name, 0, size, value, problems=item.problems),)),)
    is_request = seen.flow.direction is Direction.REQUEST
    function_id, command = question or (None, None)
    whole = fields(item, is_request, function_id, command)
    wire = envelope(item)
    if not wire:
        return (Section("", item.raw, whole),)
    inner = Section("unpacked, the first 9 bytes and EOT as above:", item.body, whole[4:-1])
    return (Section("", item.raw, wire), inner)


def rows(section: Section, full: bool = False, tongue: Tongue = english) -> Iterator[Row]:
    """Yield the rows of a section in the order of its bytes, lazily.

    Args:
        section: one of `sections`.
        full: every character and every element, not only the first of many.
        tongue: for what is said of a field; its name is the same in any.
    """
    for field in section.fields:
        yield from _field(field, 0, full, tongue)


def _field(field: Field, depth: int, full: bool, tongue: Tongue) -> Iterator[Row]:
    """Yield a field and what it consists of."""
    kind = RowKind.FIELD if field.children else RowKind.LEAF
    failed = is_failure(field.value) if field.name == HRESULT and isinstance(field.value, int) else None
    text = meaning(field, None if full else LONGEST_STRING, tongue)
    yield Row(kind, depth, field.start, field.stop, field.name, text, failed)
    if kind is RowKind.LEAF:
        yield from _problems(field.start, field.stop, field.problems, depth, tongue)
    yield from _children(field, depth + 1, full, tongue)
    if failed is not None and isinstance(field.value, int):
        found = describe(field.value)
        for note in filter(None, (found.advice, "the meaning is a guess" if found.guess else None)):
            yield Row(RowKind.NOTE, depth + 1, field.start, field.start, "", tongue(note))


def _children(field: Field, depth: int, full: bool, tongue: Tongue) -> Iterator[Row]:
    count = len(field.value) if isinstance(field.value, tuple) and field.name == "data" else 0
    if full or count <= MOST_ELEMENTS:
        for child in field.children:
            yield from _field(child, depth, full, tongue)
        return
    start = field.start
    for child in islice(field.children, MOST_ELEMENTS):
        yield from _field(child, depth, full, tongue)
        start = child.stop
    more = f"… {tongue(f'{count - MOST_ELEMENTS} more')}"
    yield Row(RowKind.LEAF, depth, start, field.stop, more, "")
    for problem in field.problems:
        if problem.offset >= start:
            yield from _problems(problem.offset, problem.offset + 1, (problem,), depth, tongue)


def _problems(
    start: int, stop: int, problems: Iterable[Problem], depth: int, tongue: Tongue
) -> Iterator[Row]:
    for problem in problems:
        yield Row(RowKind.PROBLEM, depth, start, stop, "", tongue(printable(problem.reason)))
