"""The lists of the Tester: the history of calls, watched variables, and saved requests."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from rich.cells import cell_len, set_cell_size
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.events import Resize
from textual.message import Message

from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.render.escape import printable
from bcapscope.render.text_charts import sparkline
from bcapscope.render.value_text import variant_values_text
from bcapscope.tui.controller_access.call_history import history_filter, history_line
from bcapscope.tui.controller_access.saved_requests import SavedRequest, list_requests
from bcapscope.tui.controller_access.watched_variables import VariableWatcher, WatchedVariable, WatchSeries
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.lines import ItemList, Lines
from bcapscope.tui.widgets.text_widgets import CheckedInput

MAX_CALLS = 20_000
"""Maximum number of calls in the history; the oldest calls are dropped first."""

MAX_BYTES = 32 << 20
"""Maximum size in bytes of the packets in the history; the oldest calls are dropped first."""


class HistoryLines(ItemList[HistoryRecord]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("r", "want('again')", "tester.again"),
        Binding("e", "want('edit')", "tester.edit"),
        Binding("x", "want('hex')", "tester.copy.hex"),
        Binding("p", "want('python')", "tester.copy.python"),
        Binding("c", "want('line')", "tester.copy.line"),
        Binding("s", "want('save')", "tester.save"),
    ]
    follows_end = True

    @dataclass
    class ActionWanted(Message):
        """`what` is an action: ``again``, ``edit``, ``hex``, ``python``, ``line`` or ``save``."""

        record: HistoryRecord
        what: str

    def item_line(self, item: HistoryRecord) -> str:
        return history_line(item, INK)

    def action_want(self, what: str) -> None:
        if self.current_item is not None:
            self.post_message(self.ActionWanted(self.current_item, what))


class HistoryPanel(Vertical):
    BINDINGS: ClassVar[list[BindingType]] = [Binding("slash", "filter", "traffic.filter", key_display="/")]

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

    def action_filter(self) -> None:
        self.query_one(CheckedInput).field.focus()

    @on(CheckedInput.Entered)
    def _focus_list(self) -> None:
        self.query_one(HistoryLines).focus()

    @on(Lines.Chosen)
    def _edit_chosen(self) -> None:
        self.query_one(HistoryLines).action_want("edit")

    def _show_matching(self) -> None:
        lines = self.query_one(HistoryLines)
        lines.show_items([each for each in self._records if self._matches_filter(each)])
        lines.action_to_end()


class ColumnWidths(NamedTuple):
    name: int
    number: int
    sparkline: int


WIDE, NARROW = ColumnWidths(28, 12, 30), ColumnWidths(14, 11, 15)


class WatchList(ItemList[tuple[WatchedVariable | None, int]]):
    """Shows watched variables below a line with column titles. Each element of an array has its own line."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("delete", "remove", "tester.unwatch"),
        Binding("0", "reset", "tester.watch.reset"),
    ]

    @dataclass
    class ChangeWanted(Message):
        change: Callable[[VariableWatcher], Coroutine[Any, Any, None]]

    def show_variables(self, watched: tuple[WatchedVariable, ...]) -> None:
        rows = [(each, index) for each in watched for index in range(max(1, len(each.series)))]
        self.show_items([(None, 0), *rows] if rows else [])
        self.repaint()  # values may be new even if the list of variables is unchanged

    def item_line(self, item: tuple[WatchedVariable | None, int]) -> str:
        watched, at = item
        if watched is None:
            return _title_row(self._widths)
        index_text = f" [{at}]" if len(watched.series) > 1 else ""
        name = set_cell_size(printable(watched.label) if at == 0 else "", self._widths.name - len(index_text))
        head = f"{INK.name}{name}{index_text}{INK.reset}"
        if watched.problem:
            return f"{head} {INK.bad}{printable(watched.problem)}{INK.reset}"
        if not watched.series:
            value = "" if watched.value is None else variant_values_text(watched.value)
            return f"{head} {INK.number}{value}{INK.reset}"
        return f"{head} {_number_columns(watched.series[at], self._widths, watched.decimals)}"

    @property
    def _widths(self) -> ColumnWidths:
        fits = self.size.width >= WIDE.name + 4 * (WIDE.number + 1) + WIDE.sparkline
        return WIDE if fits else NARROW

    def on_resize(self, event: Resize) -> None:
        super().on_resize(event)
        self.repaint()

    def action_remove(self) -> None:
        watched = self.current_item[0] if self.current_item else None
        if watched is not None:
            self.post_message(self.ChangeWanted(lambda watcher: watcher.remove(watched.handle)))

    def action_reset(self) -> None:
        self.post_message(self.ChangeWanted(VariableWatcher.reset))


def _title_row(widths: ColumnWidths) -> str:
    titles = [label(f"tester.watch.{key}") for key in ("value", "rate", "least", "most")]
    numbers = "".join(f"{' ' * (widths.number - cell_len(title))}{title} " for title in titles)
    name = set_cell_size(label("tester.watch.name"), widths.name)
    return f"{INK.dim}{name} {numbers} {label('tester.watch.trend')}{INK.reset}"


def _number_columns(series: WatchSeries, widths: ColumnWidths, decimals: int) -> str:
    values = (
        (series.last, decimals),
        (series.rate, 5),
        (series.minimum, decimals),
        (series.maximum, decimals),
    )
    texts = "".join(
        f"{'' if value is None else f'{value:.{places}f}':>{widths.number}} " for value, places in values
    )
    trend = sparkline([value for _, value in series.readings][-widths.sparkline :])
    return f"{INK.number}{texts}{INK.reset} {INK.good}{trend}{INK.reset}"


_NAME_WIDTH = 28


class SavedList(ItemList[tuple[str, SavedRequest | str] | None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "edit", "tester.edit"),
        Binding("u", "reload", "tester.reload"),
    ]

    @dataclass
    class RequestWanted(Message):
        """The user wants to send a saved request, or, with `edit`, to edit the request first."""

        saved: SavedRequest
        edit: bool

    def __init__(self, folder: Path, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.folder = folder

    def on_mount(self) -> None:
        self.action_reload()

    def action_reload(self) -> None:
        """Read the folder again; the last line of the list shows the folder's name."""
        self.show_items([*list_requests(self.folder), None])

    def item_line(self, item: tuple[str, SavedRequest | str] | None) -> str:
        if item is None:
            return f"{INK.dim}{label('tester.saved.folder', path=printable(str(self.folder)))}{INK.reset}"
        name, found = item
        head = f"{INK.name}{set_cell_size(printable(name), _NAME_WIDTH)}{INK.reset}"
        if isinstance(found, str):
            return f"{head} {INK.bad}{printable(found)}{INK.reset}"
        values = " ".join(printable(str(each.value)) for each in found.values)
        note = f"  {INK.dim}{printable(found.note)}{INK.reset}" if found.note else ""
        return f"{head} {found.function.name} {INK.number}{values}{INK.reset}{note}"

    def on_lines_chosen(self) -> None:
        self._post_request(False)

    def action_edit(self) -> None:
        self._post_request(True)

    def _post_request(self, edit: bool) -> None:
        if self.current_item is not None and isinstance(self.current_item[1], SavedRequest):
            self.post_message(self.RequestWanted(self.current_item[1], edit))
