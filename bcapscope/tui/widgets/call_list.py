"""A list of the calls in a journal, one per line; the user can unfold a call to see its frames."""

from __future__ import annotations

from bisect import insort
from typing import ClassVar

from textual.binding import Binding, BindingType

from bcapscope.capture.call_store import CallStore, StoredCall
from bcapscope.render.call_text import CallRenderer
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import Call
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, reader_words
from bcapscope.tui.widgets.record_list import EndpointWriter, RecordList, right_aligned


class CallList(RecordList):
    """Shows the calls of the store that `open_calls` sets."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right", "unfold(True)", "traffic.unfold", show=False),
        Binding("left", "unfold(False)", "", show=False),
        Binding("space", "turn", "", show=False),
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._calls: CallStore | None = None
        self._unfolded: list[tuple[int, int]] = []

    def open_calls(self, calls: CallStore, live: bool) -> None:
        self._calls = calls
        self.follows_end = live

    def clear_source(self) -> None:
        self.matches, self._calls = None, None
        self.show_rows()

    def use_format(self, clock: TimeFormat, write_endpoints: EndpointWriter, origin: int) -> None:
        self._renderer = CallRenderer(clock, INK, write_endpoints, reader_words())
        self._renderer.set_time_origin(origin)

    @property
    def count(self) -> int:
        return self._call_count() + sum(extra for _, extra in self._unfolded)

    def _call_count(self) -> int:
        return self.row_count(len(self._calls)) if self._calls is not None else 0

    def show_rows(self) -> None:
        """Redraw the list after `matches` has changed, with all calls folded."""
        self._unfolded.clear()
        self.reset_lines()

    def _locate_line(self, index: int) -> tuple[int, int]:
        """Return the position of the call at a line, and the number of its frame there (0 for none)."""
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

    def call_row(self, position: int) -> StoredCall:
        assert self._calls is not None
        return self._calls.read_call(self.record_at(position) - 1)

    @property
    def current_call(self) -> tuple[StoredCall, int] | None:
        """The call under the cursor, and the number of the frame under the cursor; None in an empty list."""
        if self.cursor >= self.count:
            return None
        position, part = self._locate_line(self.cursor)
        row = self.call_row(position)
        if isinstance(row.settled, Call):
            events = row.settled.frames
            number = (
                events[part - 1].observation.number if 0 < part <= len(events) else row.settled.request.number
            )
            return row, number
        return row, row.settled.observation.number

    def go_to_call(self, row: int) -> bool:
        """Select a call by its number from 1; return whether the list shows the call."""
        position = self.row_of(row)
        if position is None or position >= self._call_count():
            return False
        self.move_cursor_to(self._line_of(position))
        return True

    def line(self, index: int) -> str:
        position, part = self._locate_line(index)
        row = self.call_row(position)
        call = row.settled
        if not part:
            if self.clock is TimeFormat.DELTA:
                self._renderer.set_time_origin(_start_of(self.call_row(max(0, position - 1))))
            many = isinstance(call, Call) and bool(call.other_frames)
            fold = " " if not isinstance(call, Call) else "▾" if self._is_unfolded(position) else "▸"
            color = INK.problem if many else INK.dim
            return f"{color}{fold}{INK.reset}{self._renderer.line(call, row.subject)}"
        if not isinstance(call, Call) or part > len(call.frames):
            return ""
        events = call.frames
        event = events[part - 1]
        before = events[part - 2].observation.time if part > 1 else call.request.time
        bracket = "└─" if part == len(events) else "├─"
        return f"        {INK.dim}{bracket}{INK.reset} {self._renderer.event_line(event, before, call)}"

    def _is_unfolded(self, position: int) -> bool:
        return any(each == position for each, _ in self._unfolded)

    def action_unfold(self, wanted: bool) -> None:
        if self.cursor >= self.count:
            return
        position, _ = self._locate_line(self.cursor)
        if self._is_unfolded(position) == wanted:
            return
        if wanted:
            call = self.call_row(position).settled
            if not isinstance(call, Call):
                return
            insort(self._unfolded, (position, len(call.frames)))
        else:
            self._unfolded = [each for each in self._unfolded if each[0] != position]
        self.reset_lines(self._line_of(position))

    def action_turn(self) -> None:
        if self.cursor < self.count:
            self.action_unfold(not self._is_unfolded(self._locate_line(self.cursor)[0]))

    def action_choose(self) -> None:
        if self.cursor < self.count and self._locate_line(self.cursor)[1]:
            super().action_choose()
        else:
            self.action_turn()

    def header(self) -> str:
        client = self.client_header or "   "
        call, time = (
            right_aligned(label("traffic.head.call"), 6),
            right_aligned(label("traffic.head.time"), 12),
        )
        return f" {call} {time} {client} {label('traffic.head.what')}"


def _start_of(row: StoredCall) -> int:
    call = row.settled
    return call.request.time if isinstance(call, Call) else call.observation.time
