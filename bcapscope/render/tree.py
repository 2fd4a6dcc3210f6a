"""A frame as an indented tree: every field with its place, its bytes, its name and its meaning."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

from bcapscope.protocol.arguments import Problem
from bcapscope.protocol.fields import HRESULT, Field, envelope, fields
from bcapscope.protocol.frame import Malformed
from bcapscope.protocol.hresult import describe, is_failure
from bcapscope.render.escape import printable
from bcapscope.render.hexdump import Highlight, hexdump
from bcapscope.render.meaning import LONGEST_STRING, meaning
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.question import Question

MOST_ELEMENTS = 32
"""Elements of an array that are shown unless all are asked for."""

BYTES_SHOWN = 8
"""Bytes of a field that one line shows."""

_HEX_WIDTH = 3 * BYTES_SHOWN
_NAME_WIDTH = 20
_INDENT = "  "


class TreeRenderer:
    """Writes frames as trees.

    Lines stay under 100 columns unless a text from the wire, or a reason, is longer.
    """

    def __init__(self, palette: Palette = PLAIN, full: bool = False, dump: bool = False) -> None:
        """Choose what is shown.

        Args:
            palette: colours.
            full: every byte, every character and every element, not only the first of many.
            dump: a hexdump under each tree, with the bytes that have problems in the palette's style.
        """
        self._palette = palette
        self._full = full
        self._dump = dump

    def lines(self, seen: Observation, question: Question | None) -> Iterator[str]:
        """Write the tree of one item, line by line.

        Args:
            seen: the frame or malformed bytes.
            question: for a reply, the request that it answers, where that was seen.
        """
        item = seen.item
        if isinstance(item, Malformed):
            yield from self._malformed(item)
            return
        is_request = seen.flow.direction is Direction.REQUEST
        function_id, command = question or (None, None)
        wire = envelope(item)
        whole = fields(item, is_request, function_id, command)
        if not wire:
            yield from self._section(whole, item.raw)
            return
        yield from self._section(wire, item.raw)
        yield f"{self._palette.dim}unpacked, the first 9 bytes and EOT as above:{self._palette.reset}"
        yield from self._section(whole[4:-1], item.body)

    def _malformed(self, item: Malformed) -> Iterator[str]:
        """Write bytes that are no frame; of a hole in a stream there is nothing but the problem to show."""
        size = len(item.raw)
        name, value = ("bytes", item.raw) if size else ("no bytes", None)
        yield from self._section((Field(name, 0, size, value, problems=item.problems),), item.raw)

    def _section(self, found: Iterable[Field], body: bytes) -> Iterator[str]:
        page = _Page(self._palette, self._full, body)
        for field in found:
            yield from page.field(field, 0)
        if self._dump and body:
            yield ""
            yield from hexdump(body, page.highlights, self._palette)


class _Page:
    """The lines of one run of bytes; remembers which of them had problems."""

    def __init__(self, palette: Palette, full: bool, body: bytes) -> None:
        self._palette = palette
        self._full = full
        self._body = body
        self._digits = len(str(len(body)))
        self.highlights: list[Highlight] = []

    def field(self, field: Field, depth: int) -> Iterator[str]:
        """Write a field and what it consists of."""
        is_leaf = not field.children
        text = meaning(field, None if self._full else LONGEST_STRING)
        yield from self._rows(field, depth, self._colored(field, text, is_leaf), is_leaf)
        if is_leaf:
            yield from self._problems(field.start, field.stop, field.problems, depth)
        yield from self._children(field, depth + 1)
        if field.name == HRESULT and isinstance(field.value, int):
            yield from self._advice(field.value, depth + 1)

    def _colored(self, field: Field, text: str, is_leaf: bool) -> str:
        color = self._palette
        if field.name == HRESULT and isinstance(field.value, int):
            return f"{color.bad if is_failure(field.value) else color.good}{text}{color.reset}"
        return f"{color.number}{text}{color.reset}" if is_leaf and text else text

    def _rows(self, field: Field, depth: int, text: str, is_leaf: bool) -> Iterator[str]:
        """Write the line of a field, and for all of a long one's bytes the lines that they need."""
        color = self._palette
        shown = self._body[field.start : field.stop] if is_leaf else b""
        name = f"{_INDENT * depth}{color.name}{field.name}{color.reset}"
        padding = " " * (_NAME_WIDTH - len(_INDENT) * depth - len(field.name) if text else 0)
        left = self._place(field.start, field.stop)
        yield f"{left}  {self._hex(shown)}  {name}{padding}{' ' if text else ''}{text}".rstrip()
        if self._full:
            for start in range(BYTES_SHOWN, len(shown), BYTES_SHOWN):
                yield f"{' ' * self._place_width}  {self._hex(shown[start:])}".rstrip()

    @property
    def _place_width(self) -> int:
        return 2 * self._digits + 2

    def _place(self, start: int, stop: int) -> str:
        """Write the offsets of the first and the last byte."""
        last = f"..{stop - 1:<{self._digits}}" if stop - start > 1 else ""
        text = f"{start:>{self._digits}}{last}" if stop > start else ""
        return f"{self._palette.dim}{text:<{self._place_width}}{self._palette.reset}"

    def _hex(self, data: bytes) -> str:
        text = data[:BYTES_SHOWN].hex(" ")
        if len(data) > BYTES_SHOWN and not self._full:
            text = data[: BYTES_SHOWN - 1].hex(" ") + " …"
        return f"{self._palette.hex}{text}{self._palette.reset}{' ' * (_HEX_WIDTH - 1 - len(text))}"

    def _children(self, field: Field, depth: int) -> Iterator[str]:
        count = len(field.value) if isinstance(field.value, tuple) and field.name == "data" else 0
        if self._full or count <= MOST_ELEMENTS:
            for child in field.children:
                yield from self.field(child, depth)
            return
        start = field.start
        for child in islice(field.children, MOST_ELEMENTS):
            yield from self.field(child, depth)
            start = child.stop
        rest = Field(f"… {count - MOST_ELEMENTS} more", start, field.stop)
        yield from self._rows(rest, depth, "", is_leaf=True)
        for problem in field.problems:
            if problem.offset >= start:
                yield from self._problems(problem.offset, problem.offset + 1, (problem,), depth)

    def _problems(self, start: int, stop: int, problems: Iterable[Problem], depth: int) -> Iterator[str]:
        color = self._palette
        margin = " " * (self._place_width + _HEX_WIDTH + 3)
        for problem in problems:
            self.highlights.append(Highlight(start, stop, color.problem))
            yield f"{margin}{_INDENT * depth}{color.problem}!! {printable(problem.reason)}{color.reset}"

    def _advice(self, code: int, depth: int) -> Iterator[str]:
        found = describe(code)
        margin = " " * (self._place_width + _HEX_WIDTH + 3)
        notes = [found.advice, "the meaning is a guess" if found.guess else None]
        for note in filter(None, notes):
            yield f"{margin}{_INDENT * depth}{self._palette.dim}{note}{self._palette.reset}"
