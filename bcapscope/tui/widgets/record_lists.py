"""Lists of frames and of calls."""

from __future__ import annotations

from abc import abstractmethod
from array import array
from bisect import bisect_left
from collections.abc import Callable, Collection
from typing import ClassVar, Generic, TypeVar

from textual.binding import Binding, BindingType

from bcapscope.capture.call_store import CallStore, StoredCall
from bcapscope.capture.observation_store import ObservationStore
from bcapscope.protocol.text_format import display_width
from bcapscope.render.call_text import CallRenderer
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Direction, Flow
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, reader_words
from bcapscope.tui.widgets.lines import Lines

Source = TypeVar("Source", ObservationStore, CallStore)

_MAX_CLIENT_LENGTH = 45


def direction_arrow(flow: Flow) -> str:
    return "→" if flow.direction is Direction.REQUEST else "←"


def client_and_arrow(flow: Flow) -> str:
    return f"{printable(str(flow.conversation.client))[:_MAX_CLIENT_LENGTH]:<21} {direction_arrow(flow)}"


class RecordList(Lines, Generic[Source]):
    """Shows the records of `source`. With a filter, the list shows only the records that match the filter and
    were found so far. `matches` contains the numbers of the shown records, counted from 1; None without a
    filter.
    """

    matches: array[int] | None = None
    clock = TimeFormat.RELATIVE
    _source: Source | None = None
    _shows_client = False
    _origin = 0

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.use_format(direction_arrow)

    @property
    def source(self) -> Source:
        assert self._source is not None
        return self._source

    def open_source(self, source: Source, live: bool) -> None:
        self._source, self.follows_end = source, live

    def clear_source(self) -> None:
        self.matches, self._source = None, None
        self.reset_lines()

    @abstractmethod
    def use_format(self, write_endpoints: Callable[[Flow], str]) -> None:
        """Render lines with `write_endpoints`, and with the time format that `set_line_format` chose."""

    def set_line_format(self, clock: TimeFormat, with_client: bool, origin: int) -> None:
        """Count relative times from `origin`, in ns since 1970."""
        if (clock, with_client, origin) != (self.clock, self._shows_client, self._origin):
            self.clock, self._shows_client, self._origin = clock, with_client, origin
            self.use_format(client_and_arrow if with_client else direction_arrow)
            self.repaint()

    @property
    def client_header(self) -> str:
        """Header above the client and the direction arrow; "" if lines do not show the client."""
        return f"{left_aligned(label('traffic.head.client'), 21)}   " if self._shows_client else ""

    @property
    def row_count(self) -> int:
        rows = self._source if self.matches is None else self.matches
        return 0 if rows is None else len(rows)

    def record_at(self, row: int) -> int:
        return row + 1 if self.matches is None else self.matches[row]

    def row_of(self, number: int) -> int | None:
        """Return the row that shows a record; None if the filter hides the record."""
        row = self.nearest_row(number)
        return row if self.matches is None or number in self.matches[row : row + 1] else None

    def nearest_row(self, number: int) -> int:
        """Return the row of a record; if the filter hides it, the row of the next visible record."""
        return number - 1 if self.matches is None else bisect_left(self.matches, number)


def left_aligned(text: str, width: int) -> str:
    return text + " " * max(0, width - display_width(text))


def right_aligned(text: str, width: int) -> str:
    return " " * max(0, width - display_width(text)) + text


class FrameList(RecordList[ObservationStore]):
    """Shows frames, with signs before the frames whose numbers are in `marks`, `related` and `evidence`."""

    related: Collection[int] = ()  # frames of the call under the cursor
    evidence: Collection[int] = ()  # frames that prove the selected finding, in the order of the finding

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.marks: dict[int, str] = {}  # the user's notes; "" for a mark without a note

    def clear_source(self) -> None:
        self.marks, self.related, self.evidence = {}, (), ()
        super().clear_source()

    def use_format(self, write_endpoints: Callable[[Flow], str]) -> None:
        words = reader_words()
        self._renderer = FrameLineRenderer(self.clock, INK, write_endpoints=write_endpoints, words=words)
        self._renderer.set_time_origin(self._origin)

    @property
    def count(self) -> int:
        return self.row_count

    @property
    def frame_number(self) -> int | None:
        return self.record_at(self.cursor) if self.cursor < self.count else None

    def line(self, index: int) -> str:
        number = self.record_at(index)
        if self.clock is TimeFormat.DELTA:
            self._renderer.set_time_origin(self.source.time_of(self.record_at(max(0, index - 1))))
        frame, call_kind, comments = self.source.read_frame(number)
        note = self.marks.get(number)
        if note:
            comments = (*comments, note)
        return f"{self._gutter(number)}{self._renderer.line(frame, call_kind, comments)}"

    def line_state(self, index: int) -> str:
        return self._gutter(self.record_at(index))

    def _gutter(self, number: int) -> str:
        mark = f"{INK.problem}●{INK.reset}" if number in self.marks else " "
        if number in self.evidence:
            return f"{mark}{INK.bad}◆{INK.reset}"
        return f"{mark}{INK.good}┃{INK.reset}" if number in self.related else f"{mark} "

    def show_related(self, related: Collection[int]) -> None:
        if related != self.related:
            changed = [self.row_of(number) for number in {*related, *self.related}]
            self.related = related
            self.redraw_lines(*(index for index in changed if index is not None))

    def header(self) -> str:
        time = {TimeFormat.UTC: 30, TimeFormat.EPOCH: 20}.get(self.clock, 12)
        client = self.client_header or "  "
        widths = {"number": 6, "time": time, "serial": 5, "reserved": 5}
        titles = {name: right_aligned(label(f"traffic.head.{name}"), width) for name, width in widths.items()}
        head = f"  {titles['number']} {titles['time']} {client}{titles['serial']} {titles['reserved']}"
        return f"{head}  {label('traffic.head.what')}"


class CallList(RecordList[CallStore]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right", "unfold(True)", "traffic.unfold", show=False),
        Binding("left", "unfold(False)", "", show=False),
        Binding("space", "turn", "", show=False),
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        # maps the position of each unfolded call to the number of the call's frames; sorted by position
        self._unfolded: dict[int, int] = {}

    def clear_source(self) -> None:
        self._unfolded.clear()
        super().clear_source()

    def use_format(self, write_endpoints: Callable[[Flow], str]) -> None:
        self._renderer = CallRenderer(self.clock, INK, write_endpoints, reader_words())
        self._renderer.set_time_origin(self._origin)

    @property
    def count(self) -> int:
        return self.row_count + sum(self._unfolded.values())

    def show_rows(self) -> None:
        """Fold all calls and redraw the list. Call this method after a change of `matches`."""
        self._unfolded.clear()
        self.reset_lines()

    def _locate_line(self, index: int) -> tuple[int, int]:
        """Return a call's position and a frame's number in the call; 0 if the line shows the call itself."""
        above = 0
        for position, extra in self._unfolded.items():
            line = position + above
            if index <= line:
                break
            if index <= line + extra:
                return position, index - line
            above += extra
        return index - above, 0

    def _line_of(self, position: int) -> int:
        return position + sum(extra for each, extra in self._unfolded.items() if each < position)

    def call_row(self, position: int) -> StoredCall:
        return self.source.read_call(self.record_at(position) - 1)

    @property
    def current_call(self) -> tuple[StoredCall, int] | None:
        """The call and the number of the frame under the cursor; None if the list is empty."""
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
        """Select the call with the number `row`, counted from 1. Return False if the list lacks the call."""
        position = self.row_of(row)
        if position is None or position >= self.row_count:
            return False
        self.move_cursor_to(self._line_of(position))
        return True

    def line(self, index: int) -> str:
        position, part = self._locate_line(index)
        row = self.call_row(position)
        call = row.settled
        if not part:
            if self.clock is TimeFormat.DELTA:
                above = self.call_row(max(0, position - 1)).settled
                first = above.request if isinstance(above, Call) else above.observation
                self._renderer.set_time_origin(first.time)
            many = isinstance(call, Call) and bool(call.other_frames)
            fold = " " if not isinstance(call, Call) else "▾" if position in self._unfolded else "▸"
            color = INK.problem if many else INK.dim
            return f"{color}{fold}{INK.reset}{self._renderer.line(call, row.subject)}"
        if not isinstance(call, Call) or part > len(call.frames):
            return ""
        events = call.frames
        event = events[part - 1]
        before = events[part - 2].observation.time if part > 1 else call.request.time
        bracket = "└─" if part == len(events) else "├─"
        return f"        {INK.dim}{bracket}{INK.reset} {self._renderer.event_line(event, before, call)}"

    def action_unfold(self, wanted: bool) -> None:
        if self.cursor >= self.count:
            return
        position, _ = self._locate_line(self.cursor)
        if (position in self._unfolded) == wanted:
            return
        if wanted:
            call = self.call_row(position).settled
            if not isinstance(call, Call):
                return
            self._unfolded[position] = len(call.frames)
            self._unfolded = dict(sorted(self._unfolded.items()))
        else:
            del self._unfolded[position]
        self.reset_lines(self._line_of(position))

    def action_turn(self) -> None:
        if self.cursor < self.count:
            self.action_unfold(self._locate_line(self.cursor)[0] not in self._unfolded)

    def action_choose(self) -> None:
        if self.cursor < self.count and self._locate_line(self.cursor)[1]:
            super().action_choose()
        else:
            self.action_turn()

    def header(self) -> str:
        client = self.client_header or "   "
        call = right_aligned(label("traffic.head.call"), 6)
        time = right_aligned(label("traffic.head.time"), 12)
        return f" {call} {time} {client} {label('traffic.head.what')}"
