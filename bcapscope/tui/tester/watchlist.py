"""Watched variables: value, rate, least, most, and their course; a row for each element of an array."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from rich.cells import cell_len, set_cell_size
from textual.binding import Binding, BindingType
from textual.events import Resize
from textual.message import Message

from bcapscope.render.escape import printable
from bcapscope.render.result import result_text
from bcapscope.tui.desk.watch import Series, Watched
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say


class Widths(NamedTuple):
    """Columns that each part of a row takes."""

    name: int
    number: int
    course: int


WIDE, NARROW = Widths(28, 12, 30), Widths(14, 11, 15)


class WatchList(Lines):
    """The variables that are watched."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("delete", "remove", "tester.unwatch", id="watch.remove"),
        Binding("0", "reset", "tester.watch.reset", id="watch.reset", tooltip="tester.watch.reset.tip"),
    ]

    class Removed(Message):
        """A variable is to be watched no more."""

        def __init__(self, handle: int) -> None:
            super().__init__()
            self.handle = handle

    class Reset(Message):
        """Extremes are to be forgotten."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._rows: list[tuple[Watched | None, int]] = []

    @property
    def count(self) -> int:
        """How many rows there are, that of the titles among them."""
        return len(self._rows)

    def show(self, watched: tuple[Watched, ...]) -> None:
        """Show variables, or new readings of the same."""
        rows: list[tuple[Watched | None, int]] = [(None, 0)]
        for each in watched:
            rows += [(each, index) for index in range(max(1, len(each.series)))]
        if not watched:
            rows = []
        if len(rows) != len(self._rows):
            self._rows = rows
            self.changed(min(self.cursor, len(rows) - 1))
        else:
            self._rows = rows
            self.repaint()

    def line(self, index: int) -> str:
        """Write a row."""
        watched, at = self._rows[index]
        if watched is None:
            return _titles(self._widths)
        index_text = f" [{at}]" if len(watched.series) > 1 else ""
        name = set_cell_size(printable(watched.label) if at == 0 else "", self._widths.name - len(index_text))
        head = f"{INK.name}{name}{index_text}{INK.reset}"
        if watched.trouble:
            return f"{head} {INK.bad}{printable(watched.trouble)}{INK.reset}"
        if not watched.series:
            value = "" if watched.value is None else result_text(watched.value)
            return f"{head} {INK.number}{value}{INK.reset}"
        return f"{head} {_numbers(watched.series[at], self._widths, watched.decimals)}"

    @property
    def _widths(self) -> Widths:
        fits = self.size.width >= WIDE.name + 4 * (WIDE.number + 1) + WIDE.course
        return WIDE if fits else NARROW

    def on_resize(self, event: Resize) -> None:
        """Write the rows for the new width."""
        super().on_resize(event)
        self.repaint()

    def action_remove(self) -> None:
        """Watch the variable no more."""
        watched = self._rows[self.cursor][0] if self._rows else None
        if watched is not None:
            self.post_message(self.Removed(watched.handle))

    def action_reset(self) -> None:
        """Forget extremes and courses."""
        self.post_message(self.Reset())


def _titles(widths: Widths) -> str:
    titles = [say(f"tester.watch.{key}") for key in ("value", "rate", "least", "most")]
    numbers = "".join(f"{' ' * (widths.number - cell_len(title))}{title} " for title in titles)
    name = set_cell_size(say("tester.watch.name"), widths.name)
    return f"{INK.dim}{name} {numbers} {say('tester.watch.course')}{INK.reset}"


def _numbers(series: Series, widths: Widths, decimals: int) -> str:
    values = ((series.last, decimals), (series.rate, 5), (series.least, decimals), (series.most, decimals))
    texts = "".join(
        f"{'' if value is None else f'{value:.{places}f}':>{widths.number}} " for value, places in values
    )
    return f"{INK.number}{texts}{INK.reset} {INK.good}{series.course(widths.course)}{INK.reset}"
