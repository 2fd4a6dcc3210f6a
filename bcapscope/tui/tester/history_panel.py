"""The history of calls: the user can filter, repeat, edit, copy and save them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.message import Message

from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.tui.controller_access.call_history import history_filter, history_line
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.checked_input import CheckedInput
from bcapscope.tui.widgets.item_list import ItemList
from bcapscope.tui.widgets.lines import Lines

MAX_CALLS = 20_000
"""Maximum number of calls in the history; the oldest calls are dropped first."""

MAX_BYTES = 32 << 20
"""Maximum size in bytes of the packets in the history.

Beyond this size, a tenth of the calls is dropped, but never the latest call.
"""


class HistoryLines(ItemList[HistoryRecord]):
    """A list of the calls that match the filter; the latest call is the last line."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("r", "want('again')", "tester.again"),
        Binding("e", "want('edit')", "tester.edit"),
        Binding("x", "want('hex')", "tester.copy.hex"),
        Binding("p", "want('python')", "tester.copy.python"),
        Binding("c", "want('line')", "tester.copy.line"),
        Binding("s", "want('save')", "tester.save"),
        Binding("slash", "filter", "traffic.filter", key_display="/"),
    ]
    follows_end = True

    class FilterWanted(Message):
        """The user wants to type a filter for the history."""

    @dataclass
    class ActionWanted(Message):
        """The user wants ``again``, ``edit``, ``hex``, ``python``, ``line`` or ``save`` to act on a call."""

        record: HistoryRecord
        what: str

    def item_line(self, item: HistoryRecord) -> str:
        return history_line(item, INK)

    def action_filter(self) -> None:
        self.post_message(self.FilterWanted())

    def action_want(self, what: str) -> None:
        if self.current_item is not None:
            self.post_message(self.ActionWanted(self.current_item, what))


class HistoryPanel(Vertical):
    @dataclass
    class RecordSelected(Message):
        """The cursor moved to a call, whose packets the screen then shows."""

        record: HistoryRecord

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._records: list[HistoryRecord] = []
        self._bytes = 0
        self._matches_filter = history_filter("")

    def compose(self) -> ComposeResult:
        yield CheckedInput("history-filter", history_filter, label("tester.filter"))
        yield HistoryLines()

    @property
    def _is_full(self) -> bool:
        count = len(self._records)
        return count > MAX_CALLS or (self._bytes > MAX_BYTES and count > 1)

    def add_record(self, record: HistoryRecord) -> None:
        self._records.append(record)
        self._bytes += record.size
        if self._is_full:
            while self._is_full:
                oldest = self._records[: len(self._records) // 10 or 1]
                del self._records[: len(oldest)]
                self._bytes -= sum(each.size for each in oldest)
            self._show_matching()
        elif self._matches_filter(record):
            self.query_one(HistoryLines).add_item(record)

    @on(CheckedInput.Typed)
    def _apply_filter(self, message: CheckedInput.Typed) -> None:
        self._matches_filter = history_filter(message.text)
        self._show_matching()

    @on(HistoryLines.FilterWanted)
    def _focus_filter(self) -> None:
        self.query_one(CheckedInput).field.focus()

    @on(CheckedInput.Entered)
    def _focus_list(self) -> None:
        self.query_one(HistoryLines).focus()

    @on(Lines.Moved)
    def _cursor_moved(self) -> None:
        lines = self.query_one(HistoryLines)
        if lines.current_item is not None and lines.has_focus:
            self.post_message(self.RecordSelected(lines.current_item))

    @on(Lines.Chosen)
    def _edit_chosen(self) -> None:
        self.query_one(HistoryLines).action_want("edit")

    def _show_matching(self) -> None:
        lines = self.query_one(HistoryLines)
        lines.show_items([each for each in self._records if self._matches_filter(each)])
        lines.action_to_end()
