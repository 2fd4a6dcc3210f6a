"""A frame as an indented tree: offset, bytes, name and meaning of every field."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.frame_outline import FieldRow, FieldRowKind, FrameSection, field_rows, frame_sections
from bcapscope.render.hexdump import Highlight, hexdump
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation

BYTES_SHOWN = 8
"""Number of bytes that one line of a field shows."""

_HEX_WIDTH = 3 * BYTES_SHOWN
_NAME_WIDTH = 20
_INDENT = "  "


@dataclass(frozen=True, slots=True)
class FrameTreeRenderer:
    """Writes frames as trees. With `full`, a tree shows all bytes of long fields. With `dump`, a hex dump
    follows each tree.

    Lines have fewer than 100 columns. Only lines with long text from the wire, or with a long problem, exceed
    100 columns.
    """

    palette: Palette = PLAIN
    full: bool = False
    dump: bool = False
    words: MessageFormatter = ENGLISH_WORDS

    def lines(self, observation: Observation, call_kind: CallKind | None) -> Iterator[str]:
        for section in frame_sections(observation, call_kind):
            if section.caption is not None:
                yield f"{self.palette.dim}{self.words.text(section.caption)}{self.palette.reset}"
            yield from self._section(section)

    def _section(self, section: FrameSection) -> Iterator[str]:
        page = _TreeSection(self.palette, self.full, section.body)
        for row in field_rows(section, self.full, self.words):
            yield from page.row_lines(row)
        if self.dump and section.body:
            yield ""
            yield from hexdump(section.body, page.highlights, self.palette)


@dataclass(frozen=True, slots=True)
class _TreeSection:
    """Writes the lines of one section. `highlights` collects the positions of bytes that have problems."""

    palette: Palette
    full: bool
    body: bytes
    highlights: list[Highlight] = field(default_factory=list)

    def row_lines(self, row: FieldRow) -> Iterator[str]:
        color = self.palette
        margin = " " * (self._offsets_width + _HEX_WIDTH + 3) + _INDENT * row.depth
        if row.kind is FieldRowKind.PROBLEM:
            self.highlights.append(Highlight(row.start, row.stop, color.problem))
            yield f"{margin}{color.problem}!! {row.text}{color.reset}"
        elif row.kind is FieldRowKind.NOTE:
            yield f"{margin}{color.dim}{row.text}{color.reset}"
        else:
            yield from self._field_lines(row)

    def _field_lines(self, row: FieldRow) -> Iterator[str]:
        color = self.palette
        shown = self.body[row.start : row.stop] if row.kind is FieldRowKind.LEAF else b""
        name = f"{_INDENT * row.depth}{color.name}{row.name}{color.reset}"
        padding = " " * (_NAME_WIDTH - len(_INDENT) * row.depth - len(row.name) if row.text else 0)
        text = f"{' ' if row.text else ''}{colored_value(row, color)}"
        offsets = self._offsets_text(row.start, row.stop)
        yield f"{offsets}  {self._hex_text(shown)}  {name}{padding}{text}".rstrip()
        if self.full:
            for start in range(BYTES_SHOWN, len(shown), BYTES_SHOWN):
                yield f"{' ' * self._offsets_width}  {self._hex_text(shown[start:])}".rstrip()

    @property
    def _digits(self) -> int:
        return len(str(len(self.body)))

    @property
    def _offsets_width(self) -> int:
        return 2 * self._digits + 2

    def _offsets_text(self, start: int, stop: int) -> str:
        last = f"..{stop - 1:<{self._digits}}" if stop - start > 1 else ""
        text = f"{start:>{self._digits}}{last}" if stop > start else ""
        return f"{self.palette.dim}{text:<{self._offsets_width}}{self.palette.reset}"

    def _hex_text(self, data: bytes) -> str:
        text = data[:BYTES_SHOWN].hex(" ")
        if len(data) > BYTES_SHOWN and not self.full:
            text = data[: BYTES_SHOWN - 1].hex(" ") + " …"
        return f"{self.palette.hex}{text}{self.palette.reset}{' ' * (_HEX_WIDTH - 1 - len(text))}"


def colored_value(row: FieldRow, palette: Palette) -> str:
    """Return the meaning of a row in colour: a result code in the colour of success or failure, any other
    value in the colour of numbers.
    """
    if row.failed is not None:
        return f"{palette.bad if row.failed else palette.good}{row.text}{palette.reset}"
    if row.kind is FieldRowKind.LEAF and row.text:
        return f"{palette.number}{row.text}{palette.reset}"
    return row.text
