"""A frame as an indented tree: offset, bytes, name and meaning of every field."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import islice
from typing import NamedTuple

from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Malformed
from bcapscope.protocol.codec.variant import vt_name
from bcapscope.protocol.dissection.frame_field import HRESULT, FrameField, envelope_fields, frame_fields
from bcapscope.protocol.tables.hresult import describe_hresult, is_failure
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.hexdump import Highlight, hexdump
from bcapscope.render.value_text import LONGEST_STRING, value_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Observation

MAX_ELEMENTS = 32  # elements of an array; the option `full` shows all elements


class FieldRowKind(Enum):
    FIELD = "field"  # a field with inner fields, whose rows follow
    LEAF = "leaf"  # a field without inner fields
    PROBLEM = "problem"  # a problem with the bytes from `start` to `stop` of the row
    NOTE = "note"  # a remark about a result code; the row has no bytes


class FieldRow(NamedTuple):
    """A row of the tree. `start` and `stop` are offsets in the body of the section. `name` and `text` are
    escaped. If the field is an HRESULT, `failed` says whether it means failure; otherwise, `failed` is None.
    """

    kind: FieldRowKind
    depth: int
    start: int
    stop: int
    name: str
    text: str
    failed: bool | None = None


class FrameSection(NamedTuple):
    """A part of the tree. The offsets of the fields count from the start of `body`."""

    caption: Message | None
    body: bytes
    fields: tuple[FrameField, ...]


def frame_sections(observation: Observation, call_kind: CallKind | None) -> tuple[FrameSection, ...]:
    """Return two sections for a compressed frame, otherwise one section."""
    item = observation.item
    if isinstance(item, Malformed):
        # Malformed bytes have no fields, and a gap in a stream has no bytes: show only the problem.
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
    """Yield the rows of a section, in the order of the bytes. `full` shows strings and arrays completely."""
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
    """Return the meaning of a field in one line, or "" if the field's name suffices. A string is cut after
    `longest` characters."""
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


BYTES_SHOWN = 8  # bytes of a field in one line

_HEX_WIDTH = 3 * BYTES_SHOWN
_NAME_WIDTH = 20
_INDENT = "  "


@dataclass(frozen=True, slots=True)
class FrameTreeRenderer:
    """Writes frames as trees. With `full`, a tree shows all bytes of long fields. With `dump`, a hex dump
    follows each section of a tree.

    Lines have fewer than 100 columns, except for lines with long text from the wire or a long problem.
    """

    palette: Palette = PLAIN
    full: bool = False
    dump: bool = False
    words: MessageFormatter = ENGLISH_WORDS

    def lines(self, observation: Observation, call_kind: CallKind | None) -> Iterator[str]:
        color = self.palette
        for section in frame_sections(observation, call_kind):
            if section.caption is not None:
                yield f"{color.dim}{self.words.text(section.caption)}{color.reset}"
            highlights = []
            for row in field_rows(section, self.full, self.words):
                if row.kind is FieldRowKind.PROBLEM:
                    highlights.append(Highlight(row.start, row.stop, color.problem))
                yield from self._row_lines(row, section.body)
            if self.dump and section.body:
                yield ""
                yield from hexdump(section.body, highlights, color)

    def _row_lines(self, row: FieldRow, body: bytes) -> Iterator[str]:
        color, indent, digits = self.palette, _INDENT * row.depth, len(str(len(body)))
        offsets_width = 2 * digits + 2
        margin = " " * (offsets_width + _HEX_WIDTH + 3) + indent
        if row.kind is FieldRowKind.PROBLEM:
            yield f"{margin}{color.problem}!! {row.text}{color.reset}"
            return
        if row.kind is FieldRowKind.NOTE:
            yield f"{margin}{color.dim}{row.text}{color.reset}"
            return
        last = f"..{row.stop - 1:<{digits}}" if row.stop - row.start > 1 else ""
        offsets = f"{row.start:>{digits}}{last}" if row.stop > row.start else ""
        shown = body[row.start : row.stop] if row.kind is FieldRowKind.LEAF else b""
        padding = " " * (_NAME_WIDTH - len(indent) - len(row.name)) + " " if row.text else ""
        name = f"{indent}{color.name}{row.name}{color.reset}{padding}{colored_value(row, color)}"
        head = f"{color.dim}{offsets:<{offsets_width}}{color.reset}"
        yield f"{head}  {self._hex_text(shown)}  {name}".rstrip()
        if self.full:
            for start in range(BYTES_SHOWN, len(shown), BYTES_SHOWN):
                yield f"{' ' * offsets_width}  {self._hex_text(shown[start:])}".rstrip()

    def _hex_text(self, data: bytes) -> str:
        text = data[:BYTES_SHOWN].hex(" ")
        if len(data) > BYTES_SHOWN and not self.full:
            text = data[: BYTES_SHOWN - 1].hex(" ") + " …"
        return f"{self.palette.hex}{text}{self.palette.reset}{' ' * (_HEX_WIDTH - 1 - len(text))}"


def colored_value(row: FieldRow, palette: Palette) -> str:
    """Return the text of a row. The colour of a result code shows success or failure."""
    if row.failed is not None:
        return f"{palette.bad if row.failed else palette.good}{row.text}{palette.reset}"
    if row.kind is FieldRowKind.LEAF and row.text:
        return f"{palette.number}{row.text}{palette.reset}"
    return row.text
