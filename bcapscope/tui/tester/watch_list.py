"""The list of watched variables: value, rate, extremes, recent readings; one row per array element."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from rich.cells import cell_len, set_cell_size
from textual.binding import Binding, BindingType
from textual.events import Resize
from textual.message import Message

from bcapscope.render.escape import printable
from bcapscope.render.result_values import variant_values_text
from bcapscope.tui.controller_access.watched_variables import WatchedVariable, WatchSeries
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.lines import Lines


class ColumnWidths(NamedTuple):
    """Widths of the columns of a row, in characters."""

    name: int
    number: int
    sparkline: int


WIDE, NARROW = ColumnWidths(28, 12, 30), ColumnWidths(14, 11, 15)


class WatchList(Lines):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("delete", "remove", "tester.unwatch"),
        Binding("0", "reset", "tester.watch.reset"),
    ]

    @dataclass
    class RemoveWanted(Message):
        handle: int

    class ResetWanted(Message):
        """The user wants to reset minimum and maximum of the watched variables."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._rows: list[tuple[WatchedVariable | None, int]] = []

    @property
    def count(self) -> int:
        return len(self._rows)

    def show_variables(self, watched: tuple[WatchedVariable, ...]) -> None:
        rows: list[tuple[WatchedVariable | None, int]] = [(None, 0)]
        for each in watched:
            rows += [(each, index) for index in range(max(1, len(each.series)))]
        if not watched:
            rows = []
        if len(rows) != len(self._rows):
            self._rows = rows
            self.reset_lines(min(self.cursor, len(rows) - 1))
        else:
            self._rows = rows
            self.repaint()

    def line(self, index: int) -> str:
        watched, at = self._rows[index]
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
        """Stop watching the variable."""
        watched = self._rows[self.cursor][0] if self._rows else None
        if watched is not None:
            self.post_message(self.RemoveWanted(watched.handle))

    def action_reset(self) -> None:
        self.post_message(self.ResetWanted())


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
    return f"{INK.number}{texts}{INK.reset} {INK.good}{series.sparkline_text(widths.sparkline)}{INK.reset}"
