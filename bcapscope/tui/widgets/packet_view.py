"""Show a frame as a tree and as bytes, side by side, both with the selected field highlighted."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import ClassVar, NamedTuple

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal
from textual.events import Resize
from textual.message import Message

from bcapscope.render.frame_tree import (
    FieldRow,
    FieldRowKind,
    FrameSection,
    colored_value,
    field_rows,
    frame_sections,
)
from bcapscope.render.hexdump import PER_LINE, Highlight, hexdump
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation
from bcapscope.tui.ink import CURSOR, INK, LIT
from bcapscope.tui.reader_language import reader_words
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.plain_containers import PlainContainer

MAX_ROWS = 20_000
"""Maximum number of rows per section. A frame of a megabyte has more fields than a user can read."""

_NAME_WIDTH = 18
_NARROW_NAME, _NARROW_TREE = 14, 44
_FOLDED_AT_FIRST = 6
"""Maximum number of inner rows of a top-level branch that is folded at first. A longer branch, or
a branch with a problem, is unfolded at first.
"""


class _Entry(NamedTuple):
    """A line of the tree: a field of a section, or the section's caption if `row` is None."""

    section: int
    row: FieldRow | None


class FieldTree(Lines):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "fold", "tree.fold", show=False),
        Binding("right", "unfold", "tree.unfold", show=False),
        Binding("space", "turn", "", show=False),
        Binding("a", "full", "tree.full"),
    ]

    @dataclass
    class FieldSelected(Message):
        """The cursor moved to the field with the bytes from `begin` up to, but not including, `end`."""

        section: int
        begin: int
        end: int

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._sections: tuple[FrameSection, ...] = ()
        self._entries: list[_Entry] = []
        self._folded: set[int] = set()
        self._visible: list[int] = []
        self._full = False

    def show_sections(self, sections: tuple[FrameSection, ...]) -> None:
        self._sections = sections
        self._full = False
        self._rebuild()

    def select_field_at(self, section: int, offset: int) -> tuple[int, int]:
        """Select the innermost field that contains the byte at `offset`, but post no message. Return the
        field's start and end, or zeros if no field contains the byte.
        """
        found = None
        for index, entry in enumerate(self._entries):
            row = entry.row
            if row is not None and entry.section == section and row.start <= offset < row.stop and row.name:
                found = index
        if found is None:
            return 0, 0
        parents = {at for at in self._folded if at < found < self._branch_end(at)}
        if parents:
            self._folded -= parents
            self._update_visible()
        with self.prevent(Lines.Moved):
            self.move_cursor_to(self._visible.index(found))
        row = self._entries[found].row
        return (row.start, row.stop) if row is not None else (0, 0)

    @property
    def offset_in_frame(self) -> int:
        row = self._entries[self._visible[self.cursor]].row if self._visible else None
        return 0 if row is None else row.start

    @property
    def count(self) -> int:
        return len(self._visible)

    def line(self, index: int) -> str:
        at = self._visible[index]
        section, row = self._entries[at]
        if row is None:
            caption = self._sections[section].caption
            return "" if caption is None else f"{INK.dim}{reader_words().text(caption)}{INK.reset}"
        indent = "  " * row.depth
        if row.kind is FieldRowKind.PROBLEM:
            return f"       {indent}{INK.problem}!! {row.text}{INK.reset}"
        if row.kind is FieldRowKind.NOTE:
            return f"       {indent}{INK.dim}{row.text}{INK.reset}"
        fold = " " if not self._is_branch(at) else "▸" if at in self._folded else "▾"
        name_width = _NARROW_NAME if self.size.width < _NARROW_TREE else _NAME_WIDTH
        width = max(1, name_width - len(indent))
        place = f"{row.start:>4}" if row.stop > row.start else "    "
        return f"{INK.dim}{place} {fold}{INK.reset} {indent}{row.name:<{width}} {colored_value(row, INK)}"

    def on_lines_moved(self, message: Lines.Moved) -> None:
        if not self._visible:
            return
        section, row = self._entries[self._visible[self.cursor]]
        if row is not None:
            self.post_message(self.FieldSelected(section, row.start, row.stop))

    def _rebuild(self) -> None:
        self._entries = []
        for number, section in enumerate(self._sections):
            if section.caption is not None:
                self._entries.append(_Entry(number, None))
            rows = islice(field_rows(section, self._full, reader_words()), MAX_ROWS)
            self._entries += [_Entry(number, row) for row in rows]
        self._folded = {at for at in range(len(self._entries)) if self._is_short_branch(at)}
        self._update_visible()
        self.reset_lines()

    def _is_short_branch(self, at: int) -> bool:
        row = self._entries[at].row
        if row is None or row.depth or row.kind is not FieldRowKind.FIELD:
            return False
        branch = self._entries[at : self._branch_end(at)]
        has_problem = any(each is not None and each.kind is FieldRowKind.PROBLEM for _, each in branch)
        return len(branch) <= _FOLDED_AT_FIRST + 1 and not has_problem

    def _branch_end(self, at: int) -> int:
        """Return the index of the first entry after the branch that begins at index `at`."""
        if not self._is_branch(at):
            return at + 1
        later = range(at + 2, len(self._entries))
        return next((each for each in later if self._depth(each) <= self._depth(at)), len(self._entries))

    def _is_branch(self, at: int) -> bool:
        row = self._entries[at].row
        is_field = row is not None and row.kind in (FieldRowKind.FIELD, FieldRowKind.LEAF)
        return is_field and at + 1 < len(self._entries) and self._depth(at + 1) > self._depth(at)

    def _depth(self, at: int) -> int:
        row = self._entries[at].row
        return -1 if row is None else row.depth

    def _update_visible(self) -> None:
        self._visible = []
        at = 0
        while at < len(self._entries):
            self._visible.append(at)
            at = self._branch_end(at) if at in self._folded else at + 1

    def _set_folded(self, at: int, folded: bool) -> None:
        (self._folded.add if folded else self._folded.discard)(at)
        self._update_visible()
        self.reset_lines(self._visible.index(at))

    def action_fold(self) -> None:
        if not self._visible:
            return
        at = self._visible[self.cursor]
        if self._is_branch(at) and at not in self._folded:
            self._set_folded(at, True)
            return
        parent = next((each for each in range(at - 1, -1, -1) if at < self._branch_end(each)), None)
        if parent is not None:
            self.move_cursor_to(self._visible.index(parent))

    def action_unfold(self) -> None:
        if self._visible and self._visible[self.cursor] in self._folded:
            self._set_folded(self._visible[self.cursor], False)

    def action_turn(self) -> None:
        if self._visible:
            at = self._visible[self.cursor]
            if self._is_branch(at):
                self._set_folded(at, at not in self._folded)

    def action_full(self) -> None:
        self._full = not self._full
        self._rebuild()


_FEW_BYTES = 8
_OFFSET_WIDTH = 8  # columns before the first byte of a line: six digits and two spaces


def width_for(per_line: int) -> int:
    return _OFFSET_WIDTH + 3 * per_line - (per_line <= _FEW_BYTES) + 2 + per_line


class HexView(Lines):
    """Shows bytes with their offsets, and highlights the bytes of one field. The cursor marks a single byte,
    not a line.
    """

    highlights_cursor_line = False
    _sections: tuple[FrameSection, ...] = ()
    _per_line = PER_LINE
    _highlighted = (0, 0, 0)  # section, start and end
    _cursor_byte = (0, 0)  # section and offset

    @dataclass
    class ByteSelected(Message):
        """The cursor moved to the byte at `offset` of a section."""

        section: int
        offset: int

    def show_sections(self, sections: tuple[FrameSection, ...]) -> None:
        self._sections = sections
        self._highlighted, self._cursor_byte = (0, 0, 0), (0, 0)
        self.reset_lines()

    def highlight_bytes(self, section: int, start: int, stop: int, follow: bool = True) -> None:
        """Highlight the bytes of a field; with `follow`, move the cursor to the first of these bytes."""
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

    def _locate_line(self, index: int) -> tuple[int, int]:
        """Return the section of a line, and the line's row in the section. The caption is row -1."""
        section = 0
        while index >= self._section_height(section):
            index -= self._section_height(section)
            section += 1
        return section, index - bool(self._sections[section].caption)

    def line(self, index: int) -> str:
        section, row = self._locate_line(index)
        caption, body, _ = self._sections[section]
        return self._hex_row(section, body, row) if row >= 0 else f"{INK.dim}{caption}{INK.reset}"

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
        fits = PER_LINE if event.size.width >= width_for(PER_LINE) else _FEW_BYTES
        if fits != self._per_line:
            self._per_line = fits
            self.reset_lines()
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

    def action_sideways(self, by: int) -> None:
        section, offset = self._cursor_byte
        offset += by
        if offset < 0 and section:
            section -= 1
            offset = len(self._sections[section].body) - 1
        elif section + 1 < len(self._sections) and offset >= len(self._sections[section].body):
            section, offset = section + 1, 0
        self._select_byte(section, offset)

    def action_move(self, by: int) -> None:
        self.action_sideways(by * self._per_line)

    def action_page(self, by: int) -> None:
        self.action_move(by * max(1, self.size.height - 1))

    def action_to_start(self) -> None:
        self._select_byte(0, 0)

    def action_to_end(self) -> None:
        if self._sections:
            self._select_byte(len(self._sections) - 1, len(self._sections[-1].body) - 1)

    def click_line(self, index: int, column: int, clicks: int) -> None:
        byte = _byte_at(column, self._per_line)
        section, row = self._locate_line(index)
        if byte is not None and row >= 0:
            self._select_byte(section, row * self._per_line + byte)


def _byte_at(column: int, per_line: int) -> int | None:
    letters = width_for(per_line) - per_line
    if column >= letters:
        return min(column - letters, per_line - 1)
    pairs = column - _OFFSET_WIDTH
    if pairs < 0:
        return None
    if per_line > _FEW_BYTES and pairs >= 3 * _FEW_BYTES:
        pairs -= 1
    return min(pairs // 3, per_line - 1)


_TREE_AT_LEAST = 48
"""Columns that must remain for the tree; otherwise the byte view shows eight bytes per line instead of 16."""


class PacketView(Horizontal, PlainContainer):
    """Shows a frame, or other bytes, as a tree and as bytes."""

    def compose(self) -> ComposeResult:
        yield FieldTree(id="fields")
        yield Container(classes="edge")  # draws a vertical line, because `Lines` widgets have no borders
        yield HexView(id="bytes")

    def show_packet(self, observation: Observation | None, call_kind: CallKind | None = None) -> None:
        """Show an observation, or nothing. For a reply, `call_kind` is the kind of its request."""
        found = () if observation is None else frame_sections(observation, call_kind)
        self.query_one(HexView).show_sections(found)
        with self.prevent(Lines.Moved):
            self.query_one(FieldTree).show_sections(found)

    def on_resize(self, event: Resize) -> None:
        scrollbar, edge = 1, 1
        wide = width_for(PER_LINE) + scrollbar
        fits = event.size.width - edge - wide >= _TREE_AT_LEAST
        self.query_one(HexView).styles.width = wide if fits else width_for(8) + scrollbar

    def on_field_tree_field_selected(self, message: FieldTree.FieldSelected) -> None:
        self.query_one(HexView).highlight_bytes(message.section, message.begin, message.end)

    def on_hex_view_byte_selected(self, message: HexView.ByteSelected) -> None:
        start, stop = self.query_one(FieldTree).select_field_at(message.section, message.offset)
        if stop:
            self.query_one(HexView).highlight_bytes(message.section, start, stop, follow=False)
