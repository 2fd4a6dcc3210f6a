"""A frame as an indented tree: every field with its place, its bytes, its name and its meaning."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.render.hexdump import Highlight, hexdump
from bcapscope.render.outline import Row, RowKind, Section, rows, sections
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.question import Question

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
        for section in sections(seen, question):
            if section.caption:
                yield f"{self._palette.dim}{section.caption}{self._palette.reset}"
            yield from self._section(section)

    def _section(self, section: Section) -> Iterator[str]:
        page = _Page(self._palette, self._full, section.body)
        for row in rows(section, self._full):
            yield from page.row(row)
        if self._dump and section.body:
            yield ""
            yield from hexdump(section.body, page.highlights, self._palette)


class _Page:
    """The lines of one run of bytes; remembers which of them had problems."""

    def __init__(self, palette: Palette, full: bool, body: bytes) -> None:
        self._palette = palette
        self._full = full
        self._body = body
        self._digits = len(str(len(body)))
        self.highlights: list[Highlight] = []

    def row(self, row: Row) -> Iterator[str]:
        """Write a row: a line, and for all of a long field's bytes the lines that they need."""
        color = self._palette
        margin = " " * (self._place_width + _HEX_WIDTH + 3) + _INDENT * row.depth
        if row.kind is RowKind.PROBLEM:
            self.highlights.append(Highlight(row.start, row.stop, color.problem))
            yield f"{margin}{color.problem}!! {row.text}{color.reset}"
        elif row.kind is RowKind.NOTE:
            yield f"{margin}{color.dim}{row.text}{color.reset}"
        else:
            yield from self._field(row)

    def _field(self, row: Row) -> Iterator[str]:
        color = self._palette
        shown = self._body[row.start : row.stop] if row.kind is RowKind.LEAF else b""
        name = f"{_INDENT * row.depth}{color.name}{row.name}{color.reset}"
        padding = " " * (_NAME_WIDTH - len(_INDENT) * row.depth - len(row.name) if row.text else 0)
        text = f"{' ' if row.text else ''}{value_colored(row, color)}"
        yield f"{self._place(row.start, row.stop)}  {self._hex(shown)}  {name}{padding}{text}".rstrip()
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


def value_colored(row: Row, palette: Palette) -> str:
    """Write what a row means in its colour: results as good or bad, other values as numbers."""
    if row.failed is not None:
        return f"{palette.bad if row.failed else palette.good}{row.text}{palette.reset}"
    if row.kind is RowKind.LEAF and row.text:
        return f"{palette.number}{row.text}{palette.reset}"
    return row.text
