"""Shows the bytes of a frame in hex, with a cursor that moves by bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.events import Click, Resize
from textual.message import Message

from bcapscope.render.frame_outline import FrameSection
from bcapscope.render.hexdump import PER_LINE, Highlight, hexdump
from bcapscope.tui.ink import CURSOR, INK, LIT
from bcapscope.tui.widgets.lines import Lines

_NARROW = 8
_OFFSET_WIDTH = 8
"""Number of columns before the first byte of a line: six digits and two spaces."""


def width_for(per_line: int) -> int:
    """Return the number of columns that a line with `per_line` bytes needs."""
    return _OFFSET_WIDTH + 3 * per_line - (per_line <= _NARROW) + 2 + per_line


class HexView(Lines):
    """Shows bytes with their offsets, and highlights the bytes of one field."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "step(-1)", "", show=False),
        Binding("right", "step(1)", "", show=False),
        Binding("up,k", "row(-1)", "", show=False),
        Binding("down,j", "row(1)", "", show=False),
        Binding("pageup", "rows(-1)", "", show=False),
        Binding("pagedown", "rows(1)", "", show=False),
        Binding("home,g", "first", "", show=False),
        Binding("end,G", "last", "", show=False),
    ]
    highlights_cursor_line = False  # the cursor is a byte

    @dataclass
    class ByteSelected(Message):
        """The cursor moved to the byte at `offset` of a section."""

        section: int
        offset: int

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._sections: tuple[FrameSection, ...] = ()
        self._per_line = PER_LINE
        self._highlighted = (0, 0, 0)
        self._cursor_byte = (0, 0)

    def show_sections(self, sections: tuple[FrameSection, ...]) -> None:
        self._sections = sections
        self._highlighted, self._cursor_byte = (0, 0, 0), (0, 0)
        self.reset_lines()

    def highlight_bytes(self, section: int, start: int, stop: int, follow: bool = True) -> None:
        """Highlight the bytes of a field; if `follow` is set, move the cursor to the first of these bytes."""
        if (section, start, stop) == self._highlighted:
            return
        self._highlighted = (section, start, stop)
        if follow:
            self._cursor_byte = (section, start)
            self._show_cursor()
        self.repaint()

    @property
    def count(self) -> int:
        return sum(map(self._section_height, range(len(self._sections))))

    def _section_height(self, section: int) -> int:
        caption, body, _ = self._sections[section]
        return bool(caption) - (-len(body) // self._per_line)

    def line(self, index: int) -> str:
        for number, (caption, body, _) in enumerate(self._sections):
            height = self._section_height(number)
            if index < height:
                index -= bool(caption)
                return f"{INK.dim}{caption}{INK.reset}" if index < 0 else self._hex_row(number, body, index)
            index -= height
        return ""

    def _hex_row(self, number: int, body: bytes, index: int) -> str:
        first = index * self._per_line
        section, start, stop = self._highlighted
        marks = [Highlight(start, stop, LIT)] if section == number and stop > start else []
        at_section, at = self._cursor_byte
        if at_section == number and self.has_focus:
            marks = sorted([*marks, Highlight(at, at + 1, CURSOR)], key=lambda mark: mark.start)
        data = body[first : first + self._per_line]
        return next(hexdump(data, marks, INK, first, self._per_line))

    def on_resize(self, event: Resize) -> None:
        fits = PER_LINE if event.size.width >= width_for(PER_LINE) else _NARROW
        if fits != self._per_line:
            self._per_line = fits
            at = self._cursor_byte
            self.reset_lines()
            self._cursor_byte = at
            self._show_cursor()

    # the cursor

    def _show_cursor(self) -> None:
        section, offset = self._cursor_byte
        if section >= len(self._sections):
            return
        above = sum(map(self._section_height, range(section))) + bool(self._sections[section].caption)
        with self.prevent(Lines.Moved):
            self.move_cursor_to(above + offset // self._per_line)

    def _select_byte(self, section: int, offset: int) -> None:
        if section >= len(self._sections) or not self._sections[section].body:
            return
        self._cursor_byte = (section, max(0, min(offset, len(self._sections[section].body) - 1)))
        self._show_cursor()
        self.repaint()
        self.post_message(self.ByteSelected(*self._cursor_byte))

    def action_step(self, by: int) -> None:
        section, offset = self._cursor_byte
        offset += by
        if offset < 0 and section:
            section -= 1
            offset = len(self._sections[section].body) - 1
        elif section + 1 < len(self._sections) and offset >= len(self._sections[section].body):
            section, offset = section + 1, 0
        self._select_byte(section, offset)

    def action_row(self, by: int) -> None:
        self.action_step(by * self._per_line)

    def action_rows(self, by: int) -> None:
        self.action_row(by * max(1, self.size.height - 1))

    def action_first(self) -> None:
        self._select_byte(0, 0)

    def action_last(self) -> None:
        if self._sections:
            self._select_byte(len(self._sections) - 1, len(self._sections[-1].body) - 1)

    def on_click(self, event: Click) -> None:
        event.prevent_default()
        offset = event.get_content_offset(self)
        if offset is None:
            return
        index = offset.y + self.scroll_offset.y
        column = offset.x + self.scroll_offset.x
        for number, (caption, _, _) in enumerate(self._sections):
            height = self._section_height(number)
            if index < height:
                row = index - bool(caption)
                byte = _byte_at(column, self._per_line)
                if row >= 0 and byte is not None:
                    self._select_byte(number, row * self._per_line + byte)
                return
            index -= height


def _byte_at(column: int, per_line: int) -> int | None:
    """Return the index of the byte at a column of a line; None if the column shows no byte."""
    letters = width_for(per_line) - per_line
    if column >= letters:
        return min(column - letters, per_line - 1)
    pairs = column - _OFFSET_WIDTH
    if pairs < 0:
        return None
    if per_line > _NARROW and pairs >= 3 * _NARROW:
        pairs -= 1
    return min(pairs // 3, per_line - 1)
