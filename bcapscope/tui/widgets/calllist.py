"""Calls of a journal, one a line, with the frames of a call folded under it."""

from __future__ import annotations

from bisect import insort
from typing import ClassVar

from textual.binding import Binding, BindingType

from bcapscope.capture.callbook import Callbook, Row
from bcapscope.render.call import CallRenderer
from bcapscope.render.moment import Clock
from bcapscope.traffic.exchange import Exchange
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.framelist import Rows, arrow, client_and_arrow, left, right
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say, told


class CallList(Lines):
    """Shows calls; `open` gives it a journal.

    Attributes:
        rows: which of them are shown.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "right",
            "unfold(True)",
            "traffic.unfold",
            id="calls.unfold",
            show=False,
            tooltip="traffic.unfold.tip",
        ),
        Binding("left", "unfold(False)", "", show=False),
        Binding("space", "turn", "", show=False),
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.rows = Rows()
        self._calls: Callbook | None = None
        self._clock = Clock.RELATIVE
        self._with_client = False
        self._live = False
        self._first = 0
        self._unfolded: list[tuple[int, int]] = []
        self._renderer = CallRenderer(palette=INK, ends=lambda flow: "", tongue=told)

    def open(self, calls: Callbook, live: bool) -> None:
        """Show the calls of a journal; of a `live` one from the end."""
        self._calls = calls
        self._live = live

    def forget(self) -> None:
        """Show nothing, until those of another journal are opened."""
        self.rows, self._calls = Rows(), None
        self.show_rows()

    def look(self, clock: Clock, with_client: bool, first: int) -> None:
        """Choose how the time is told, relative ones since `first`, and whether lines name the client."""
        if (clock, with_client, first) == (self._clock, self._with_client, self._first):
            return
        self._clock, self._with_client, self._first = clock, with_client, first
        self._renderer = CallRenderer(clock, INK, client_and_arrow if with_client else arrow, told)
        self._renderer.begin(first)
        self.repaint()

    @property
    def follows(self) -> bool:
        """Live traffic is followed as long as the cursor is on the last line."""
        return self._live

    @property
    def count(self) -> int:
        """How many lines there are, those of unfolded calls with them."""
        return self._those() + sum(extra for _, extra in self._unfolded)

    def _those(self) -> int:
        return self.rows.count(len(self._calls)) if self._calls is not None else 0

    def show_rows(self) -> None:
        """Show other rows than before, all folded."""
        self._unfolded.clear()
        self.changed()

    def _place(self, index: int) -> tuple[int, int]:
        """Tell which call a line belongs to, and which of its frames it is, from 1; 0 for the call itself."""
        above = 0
        for position, extra in self._unfolded:
            line = position + above
            if index <= line:
                break
            if index <= line + extra:
                return position, index - line
            above += extra
        return index - above, 0

    def _line_of(self, position: int) -> int:
        return position + sum(extra for each, extra in self._unfolded if each < position)

    def row(self, position: int) -> Row:
        """Read the call at a position."""
        assert self._calls is not None
        return self._calls.row(self.rows.number(position) - 1)

    @property
    def current(self) -> tuple[Row, int] | None:
        """The call that the cursor is on, and the number of the frame that it is on."""
        if self.cursor >= self.count:
            return None
        position, part = self._place(self.cursor)
        row = self.row(position)
        if isinstance(row.settled, Exchange):
            events = row.settled.events
            number = events[part - 1].seen.number if 0 < part <= len(events) else row.settled.request.number
            return row, number
        return row, row.settled.seen.number

    def go_to(self, row: int) -> bool:
        """Go to a call by its row from 1; tell whether it is shown."""
        position = self.rows.index(row)
        if position is None or position >= self._those():
            return False
        self.go(self._line_of(position))
        return True

    def line(self, index: int) -> str:
        """Write the line of a call, or of one of its frames."""
        position, part = self._place(index)
        row = self.row(position)
        call = row.settled
        if not part:
            if self._clock is Clock.DELTA and position:
                self._renderer.begin(_started(self.row(position - 1)))
            many = isinstance(call, Exchange) and bool(call.others)
            fold = " " if not isinstance(call, Exchange) else "▾" if self._is_unfolded(position) else "▸"
            color = INK.problem if many else INK.dim
            return f"{color}{fold}{INK.reset}{self._renderer.line(call, row.subject)}"
        if not isinstance(call, Exchange) or part > len(call.events):
            return ""
        events = call.events
        event = events[part - 1]
        before = events[part - 2].seen.time if part > 1 else call.request.time
        bracket = "└─" if part == len(events) else "├─"
        return f"        {INK.dim}{bracket}{INK.reset} {self._renderer.event(event, before, call)}"

    def _is_unfolded(self, position: int) -> bool:
        return any(each == position for each, _ in self._unfolded)

    def action_unfold(self, wanted: bool) -> None:
        """Show the frames of the call, or hide them."""
        if self.cursor >= self.count:
            return
        position, _ = self._place(self.cursor)
        if self._is_unfolded(position) == wanted:
            return
        if wanted:
            call = self.row(position).settled
            if not isinstance(call, Exchange):
                return
            insort(self._unfolded, (position, len(call.events)))
        else:
            self._unfolded = [each for each in self._unfolded if each[0] != position]
        self.changed(self._line_of(position))

    def action_turn(self) -> None:
        """Show the frames of the call where they are hidden, hide them where they are shown."""
        if self.cursor < self.count:
            self.action_unfold(not self._is_unfolded(self._place(self.cursor)[0]))

    def action_choose(self) -> None:
        """Unfold the call, or choose the frame."""
        if self.cursor < self.count and self._place(self.cursor)[1]:
            super().action_choose()
        else:
            self.action_turn()

    def head(self) -> str:
        """Write what stands above the columns."""
        client = f"{left(say('traffic.head.client'), 21)}   " if self._with_client else "   "
        call, time = right(say("traffic.head.call"), 6), right(say("traffic.head.time"), 12)
        return f" {call} {time} {client} {say('traffic.head.what')}"


def _started(row: Row) -> int:
    call = row.settled
    return call.request.time if isinstance(call, Exchange) else call.seen.time
