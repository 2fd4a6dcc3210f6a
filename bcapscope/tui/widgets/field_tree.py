"""Shows the fields of a frame as a tree with branches that fold."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import ClassVar, NamedTuple

from textual.binding import Binding, BindingType
from textual.message import Message

from bcapscope.render.frame_outline import FieldRow, FieldRowKind, FrameSection, field_rows
from bcapscope.render.frame_tree import colored_value
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import reader_words
from bcapscope.tui.widgets.lines import Lines

MAX_ROWS = 20_000
"""Maximum number of rows per section, because a frame of a megabyte has more fields than a user can read."""

_NAME_WIDTH = 18
_NARROW_NAME, _NARROW = 14, 44
_FOLDED_AT_FIRST = 6
"""Maximum number of rows in a branch that is folded at first, such as a number or a short text.

The row of a folded branch shows the content of the branch.
"""


class _Entry(NamedTuple):
    """An entry of the tree: a row of a section, or the caption above a section.

    Attributes:
        row: Row of the section; None for the caption.
        stop: Index after the last entry in the branch of this entry.
    """

    section: int
    row: FieldRow | None
    stop: int


class FieldTree(Lines):
    """Shows the fields of a frame; the left and right keys fold and unfold branches."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "fold", "tree.fold", show=False),
        Binding("right", "unfold", "tree.unfold", show=False),
        Binding("space", "turn", "", show=False),
        Binding("a", "full", "tree.full"),
    ]

    @dataclass
    class FieldSelected(Message):
        """The cursor moved to a row for the bytes from `begin` to `end` (exclusive) of a section."""

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
        """Select the innermost field at a byte without posting a message; return its start and end."""
        found = None
        for index, entry in enumerate(self._entries):
            row = entry.row
            if row is not None and entry.section == section and row.start <= offset < row.stop and row.name:
                found = index
        if found is None:
            return 0, 0
        parents = {at for at in self._folded if at < found < self._entries[at].stop}
        if parents:
            self._folded -= parents
            self._update_visible()
        with self.prevent(Lines.Moved):
            self.move_cursor_to(self._visible.index(found))
        row = self._entries[found].row
        return (row.start, row.stop) if row is not None else (0, 0)

    @property
    def offset_in_frame(self) -> int:
        """Offset in the frame of the first byte of the field under the cursor; 0 without field."""
        row = self._entries[self._visible[self.cursor]].row if self._visible else None
        return 0 if row is None else row.start

    @property
    def count(self) -> int:
        return len(self._visible)

    def line(self, index: int) -> str:
        """Return a row as text: the offset of its first byte, its name and its meaning."""
        at = self._visible[index]
        section, row, stop = self._entries[at]
        if row is None:
            caption = self._sections[section].caption
            return "" if caption is None else f"{INK.dim}{reader_words().text(caption)}{INK.reset}"
        indent = "  " * row.depth
        if row.kind is FieldRowKind.PROBLEM:
            return f"       {indent}{INK.problem}!! {row.text}{INK.reset}"
        if row.kind is FieldRowKind.NOTE:
            return f"       {indent}{INK.dim}{row.text}{INK.reset}"
        fold = " " if stop == at + 1 else "▸" if at in self._folded else "▾"
        name_width = _NARROW_NAME if self.size.width < _NARROW else _NAME_WIDTH
        width = max(1, name_width - len(indent))
        place = f"{row.start:>4}" if row.stop > row.start else "    "
        return f"{INK.dim}{place} {fold}{INK.reset} {indent}{row.name:<{width}} {colored_value(row, INK)}"

    def on_lines_moved(self, message: Lines.Moved) -> None:
        if not self._visible:
            return
        section, row, _ = self._entries[self._visible[self.cursor]]
        if row is not None:
            self.post_message(self.FieldSelected(section, row.start, row.stop))

    def _rebuild(self) -> None:
        self._entries = []
        for number, section in enumerate(self._sections):
            if section.caption is not None:
                self._entries.append(_Entry(number, None, len(self._entries) + 1))
            found = list(islice(field_rows(section, self._full, reader_words()), MAX_ROWS))
            self._entries += _make_entries(number, found, len(self._entries))
        self._folded = {at for at in range(len(self._entries)) if self._is_short_branch(at)}
        self._update_visible()
        self.reset_lines()

    def _is_short_branch(self, at: int) -> bool:
        """Return whether a branch starts folded: if it is short and contains no problem."""
        _, row, stop = self._entries[at]
        if row is None or row.depth or row.kind is not FieldRowKind.FIELD or stop - at - 1 > _FOLDED_AT_FIRST:
            return False
        under = [entry.row for entry in self._entries[at:stop]]
        return all(each is not None and each.kind is not FieldRowKind.PROBLEM for each in under)

    def _update_visible(self) -> None:
        self._visible = []
        at = 0
        while at < len(self._entries):
            self._visible.append(at)
            at = self._entries[at].stop if at in self._folded else at + 1

    def _set_folded(self, at: int, folded: bool) -> None:
        (self._folded.add if folded else self._folded.discard)(at)
        self._update_visible()
        self.reset_lines(self._visible.index(at))

    def action_fold(self) -> None:
        """Fold the branch under the cursor; if it is folded or a leaf, select its parent."""
        if not self._visible:
            return
        at = self._visible[self.cursor]
        if self._entries[at].stop > at + 1 and at not in self._folded:
            self._set_folded(at, True)
            return
        parents = [each for each in self._visible if each < at < self._entries[each].stop]
        if parents:
            self.move_cursor_to(self._visible.index(parents[-1]))

    def action_unfold(self) -> None:
        if self._visible and self._visible[self.cursor] in self._folded:
            self._set_folded(self._visible[self.cursor], False)

    def action_turn(self) -> None:
        if self._visible:
            at = self._visible[self.cursor]
            if self._entries[at].stop > at + 1:
                self._set_folded(at, at not in self._folded)

    def action_full(self) -> None:
        """Switch between showing all elements and characters, and showing only the first of them."""
        self._full = not self._full
        self._rebuild()


def _make_entries(section: int, found: list[FieldRow], first: int) -> list[_Entry]:
    """Return tree entries for rows; `first` is the index of the first new entry."""
    stops = [0] * len(found)
    open_rows: list[int] = []
    for index, row in enumerate(found):
        while open_rows and found[open_rows[-1]].depth >= row.depth:
            stops[open_rows.pop()] = index
        if row.kind in (FieldRowKind.FIELD, FieldRowKind.LEAF):
            open_rows.append(index)
        else:
            stops[index] = index + 1
    for index in open_rows:
        stops[index] = len(found)
    return [_Entry(section, row, first + stop) for row, stop in zip(found, stops, strict=True)]
