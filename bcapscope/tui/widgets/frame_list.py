"""The frames of a journal, one per line, with fast access to any of a million frames."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Collection, Mapping

from bcapscope.capture.observation_store import ObservationStore
from bcapscope.protocol.text_format import display_width
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.traffic.observation import Direction, Flow
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, localized, reader_words
from bcapscope.tui.widgets.lines import Lines

MARKED, RELATED, EVIDENCE = "●", "┃", "◆"
"""Marks before a frame: marked by the user, part of the call under the cursor, evidence of the selected
finding."""

_MAX_CLIENT_LENGTH = 45


def direction_arrow(flow: Flow) -> str:
    """Return an arrow for the direction of a frame, for traffic of a single client."""
    return "→" if flow.direction is Direction.REQUEST else "←"


def client_and_arrow(flow: Flow) -> str:
    """Return the client and an arrow for the direction of a frame."""
    return f"{printable(str(flow.conversation.client))[:_MAX_CLIENT_LENGTH]:<21} {direction_arrow(flow)}"


class FilteredRows:
    """The rows of a source to show: all of them, or the matches of a filter found so far."""

    def __init__(self) -> None:
        self.matches: array[int] | None = None

    def shown_count(self, total: int) -> int:
        return total if self.matches is None else len(self.matches)

    def number(self, index: int) -> int:
        """Return the number, from 1, of the row at an index."""
        return index + 1 if self.matches is None else self.matches[index]

    def index(self, number: int) -> int | None:
        """Return the index of a row; None if it is not shown."""
        if self.matches is None:
            return number - 1
        at = bisect_left(self.matches, number)
        return at if at < len(self.matches) and self.matches[at] == number else None

    def nearest(self, number: int) -> int:
        """Return the index of a row, or of the next shown row after it."""
        return number - 1 if self.matches is None else bisect_left(self.matches, number)


class FrameList(Lines):
    """Shows frames; `open_journal` sets their source.

    Attributes:
        marks: Notes by frame number; "" for a frame that is only marked.
        related: Numbers of the frames of the call under the cursor.
        evidence: Numbers of the frames that prove the selected finding.
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.rows = FilteredRows()
        self.marks: dict[int, str] = {}
        self.related: Collection[int] = ()
        self.evidence: Collection[int] = ()
        self._journal: ObservationStore | None = None
        self._clock = TimeFormat.RELATIVE
        self._with_client = False
        self._has_start_time = False
        self._renderer = FrameLineRenderer(palette=INK, write_endpoints=direction_arrow, words=reader_words())

    def open_journal(self, journal: ObservationStore, live: bool) -> None:
        self._journal = journal
        self.follows_end = live

    def clear_source(self) -> None:
        self.rows, self.marks, self.related, self.evidence = FilteredRows(), {}, (), ()
        self._journal, self._has_start_time = None, False
        self.reset_lines()

    def set_line_format(self, clock: TimeFormat, with_client: bool) -> None:
        if (clock, with_client) == (self._clock, self._with_client):
            return
        self._clock, self._with_client = clock, with_client
        self._renderer = self._new_renderer()
        self.repaint()

    def _new_renderer(self) -> FrameLineRenderer:
        ends = client_and_arrow if self._with_client else direction_arrow
        renderer = FrameLineRenderer(self._clock, INK, write_endpoints=ends, words=reader_words())
        if self._clock is TimeFormat.RELATIVE and self._journal is not None and len(self._journal):
            renderer.set_time_origin(self._journal.time_of(1))
        return renderer

    @property
    def count(self) -> int:
        return self.rows.shown_count(len(self._journal)) if self._journal is not None else 0

    @property
    def frame_number(self) -> int | None:
        """Number of the frame under the cursor; None if there is none."""
        return self.rows.number(self.cursor) if self.cursor < self.count else None

    def read_frame(self, number: int) -> AnnotatedFrame:
        assert self._journal is not None
        return self._journal.read_frame(number)

    def lines_added(self) -> None:
        """Show new lines; the first frame sets the origin of relative times."""
        if not self._has_start_time and self._clock is TimeFormat.RELATIVE and self.count:
            self._has_start_time = True
            self._renderer = self._new_renderer()
        super().lines_added()

    def line(self, index: int) -> str:
        """Return the line of a frame, with its marks before it."""
        number = self.rows.number(index)
        if self._clock is TimeFormat.DELTA and index and self._journal is not None:
            self._renderer.set_time_origin(self._journal.time_of(self.rows.number(index - 1)))
        seen, question, comments = self.read_frame(number)
        comments = tuple(map(localized, comments))
        note = self.marks.get(number)
        if note:
            comments = (*comments, note)
        return f"{self._gutter(number)}{self._renderer.line(seen, question, comments)}"

    def line_state(self, index: int) -> str:
        """Return the marks before a line, since they change its look."""
        return self._gutter(self.rows.number(index))

    def _gutter(self, number: int) -> str:
        mark = f"{INK.problem}{MARKED}{INK.reset}" if number in self.marks else " "
        if number in self.evidence:
            return f"{mark}{INK.bad}{EVIDENCE}{INK.reset}"
        return f"{mark}{INK.good}{RELATED}{INK.reset}" if number in self.related else f"{mark} "

    def show_related(self, related: Collection[int]) -> None:
        """Mark other frames as part of the call under the cursor."""
        if related != self.related:
            changed = [self.rows.index(number) for number in {*related, *self.related}]
            self.related = related
            self.redraw_lines(*(index for index in changed if index is not None))

    def header(self) -> str:
        time = {TimeFormat.UTC: 30, TimeFormat.EPOCH: 20}.get(self._clock, 12)
        client = f"{left_aligned(label('traffic.head.client'), 21)}   " if self._with_client else "  "
        words: Mapping[str, str] = {
            name: label(f"traffic.head.{name}") for name in ("number", "time", "serial", "reserved", "what")
        }
        return (
            f"  {right_aligned(words['number'], 6)} {right_aligned(words['time'], time)} {client}"
            f"{right_aligned(words['serial'], 5)} {right_aligned(words['reserved'], 5)}  {words['what']}"
        )


def left_aligned(text: str, width: int) -> str:
    """Left-align a text in a column; wide characters count two."""
    return text + " " * max(0, width - display_width(text))


def right_aligned(text: str, width: int) -> str:
    """Right-align a text in a column; wide characters count two."""
    return " " * max(0, width - display_width(text)) + text
