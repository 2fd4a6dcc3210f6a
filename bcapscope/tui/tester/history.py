"""All calls with result and time: filtered, run again, changed and run, copied, saved."""

from __future__ import annotations

from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.message import Message

from bcapscope.tui.desk.history import chooser, history_line
from bcapscope.tui.desk.record import Record
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.checkedline import CheckedLine
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say

MOST = 20_000
"""Calls that are kept; the oldest go first."""


MOST_BYTES = 32 << 20
"""Bytes of their packets; beyond that a tenth of the calls is dropped, but never the latest."""


class HistoryLines(Lines):
    """The calls that are wanted, the latest last."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("r", "want('again')", "tester.again", id="history.again", tooltip="tester.again.tip"),
        Binding("e", "want('edit')", "tester.edit", id="history.edit", tooltip="tester.edit.tip"),
        Binding("x", "want('hex')", "tester.copy.hex", id="history.hex"),
        Binding("p", "want('python')", "tester.copy.python", id="history.python"),
        Binding("c", "want('line')", "tester.copy.line", id="history.line"),
        Binding("s", "want('save')", "tester.save", id="history.save", tooltip="tester.save.tip"),
        Binding(
            "slash",
            "filter",
            "traffic.filter",
            id="history.filter",
            key_display="/",
            tooltip="traffic.filter.tip",
        ),
    ]

    class FilterWanted(Message):
        """The filter is to be typed."""

    class Wanted(Message):
        """Something is to be done with a call.

        Attributes:
            record: the call.
            what: ``again``, ``edit``, ``hex``, ``python``, ``line`` or ``save``.
        """

        def __init__(self, record: Record, what: str) -> None:
            super().__init__()
            self.record, self.what = record, what

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._shown: list[Record] = []

    @property
    def count(self) -> int:
        """How many calls are shown."""
        return len(self._shown)

    @property
    def follows(self) -> bool:
        """The latest call stays in sight."""
        return True

    @property
    def chosen(self) -> Record | None:
        """The call that the cursor is on."""
        return self._shown[self.cursor] if self._shown else None

    def line(self, index: int) -> str:
        """Write a call."""
        return history_line(self._shown[index], INK)

    def show(self, records: list[Record]) -> None:
        """Show other calls."""
        self._shown = records
        self.changed(len(records) - 1)

    def add(self, record: Record) -> None:
        """Show one more."""
        self._shown.append(record)
        self.grown()

    def action_filter(self) -> None:
        """Go to the filter."""
        self.post_message(self.FilterWanted())

    def action_want(self, what: str) -> None:
        """Have something done with the call."""
        if self.chosen is not None:
            self.post_message(self.Wanted(self.chosen, what))


class HistoryPanel(Vertical):
    """The history with its filter."""

    class Shown(Message):
        """The cursor is on a call, whose packets are to be shown."""

        def __init__(self, record: Record) -> None:
            super().__init__()
            self.record = record

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._records: list[Record] = []
        self._bytes = 0
        self._wants = chooser("")

    def compose(self) -> ComposeResult:
        """Put the filter above the calls."""
        yield CheckedLine("history-filter", chooser, say("tester.filter"))
        yield HistoryLines()

    @property
    def _is_full(self) -> bool:
        count = len(self._records)
        return count > MOST or (self._bytes > MOST_BYTES and count > 1)

    def add(self, record: Record) -> None:
        """Take a call that has ended."""
        self._records.append(record)
        self._bytes += record.size
        if self._is_full:
            while self._is_full:
                oldest = self._records[: len(self._records) // 10 or 1]
                del self._records[: len(oldest)]
                self._bytes -= sum(each.size for each in oldest)
            self._fill()
        elif self._wants(record):
            self.query_one(HistoryLines).add(record)

    @on(CheckedLine.Typed)
    def _filter(self, message: CheckedLine.Typed) -> None:
        message.stop()
        self._wants = chooser(message.text)
        self._fill()

    @on(HistoryLines.FilterWanted)
    def _to_filter(self, message: HistoryLines.FilterWanted) -> None:
        message.stop()
        self.query_one(CheckedLine).field.focus()

    @on(CheckedLine.Entered)
    def _to_list(self, message: CheckedLine.Entered) -> None:
        message.stop()
        self.query_one(HistoryLines).focus()

    @on(Lines.Moved)
    def _moved(self, message: Lines.Moved) -> None:
        message.stop()
        lines = self.query_one(HistoryLines)
        if lines.chosen is not None and lines.has_focus:
            self.post_message(self.Shown(lines.chosen))

    @on(Lines.Chosen)
    def _chosen(self, message: Lines.Chosen) -> None:
        message.stop()
        self.query_one(HistoryLines).action_want("edit")

    def _fill(self) -> None:
        self.query_one(HistoryLines).show([each for each in self._records if self._wants(each)])
