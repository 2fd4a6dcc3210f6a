"""A list of the frames in a journal, one per line, with fast access to any of a million frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from bcapscope.capture.observation_store import ObservationStore
from bcapscope.render.frame_line import FrameLineRenderer
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, reader_words
from bcapscope.tui.widgets.record_list import EndpointWriter, RecordList, right_aligned

MARKED, RELATED, EVIDENCE = "●", "┃", "◆"
"""Marks before a frame: marked by the user, part of the call under the cursor, proof of a finding."""


class FrameList(RecordList):
    """Shows the frames of the journal that `open_journal` sets.

    Attributes:
        marks: Notes by frame number; "" for a frame that the user marked without a note.
        related: Numbers of the frames of the call under the cursor.
        evidence: Numbers of the frames that prove the selected finding.
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.marks: dict[int, str] = {}
        self.related: Collection[int] = ()
        self.evidence: Collection[int] = ()
        self._journal: ObservationStore | None = None

    def open_journal(self, journal: ObservationStore, live: bool) -> None:
        self._journal = journal
        self.follows_end = live

    def clear_source(self) -> None:
        self.matches, self.marks, self.related, self.evidence = None, {}, (), ()
        self._journal = None
        self.reset_lines()

    def use_format(self, clock: TimeFormat, write_endpoints: EndpointWriter, origin: int) -> None:
        self._renderer = FrameLineRenderer(clock, INK, write_endpoints=write_endpoints, words=reader_words())
        self._renderer.set_time_origin(origin)

    @property
    def count(self) -> int:
        return self.row_count(len(self._journal)) if self._journal is not None else 0

    @property
    def frame_number(self) -> int | None:
        """Number of the frame under the cursor; None if there is none."""
        return self.record_at(self.cursor) if self.cursor < self.count else None

    def read_frame(self, number: int) -> AnnotatedFrame:
        assert self._journal is not None
        return self._journal.read_frame(number)

    def line(self, index: int) -> str:
        """Return the line of a frame, which begins with the marks of the frame."""
        number = self.record_at(index)
        if self.clock is TimeFormat.DELTA and self._journal is not None:
            self._renderer.set_time_origin(self._journal.time_of(self.record_at(max(0, index - 1))))
        seen, question, comments = self.read_frame(number)
        note = self.marks.get(number)
        if note:
            comments = (*comments, note)
        return f"{self._gutter(number)}{self._renderer.line(seen, question, comments)}"

    def line_state(self, index: int) -> str:
        """Return the marks before a line, because they change the look of the line."""
        return self._gutter(self.record_at(index))

    def _gutter(self, number: int) -> str:
        mark = f"{INK.problem}{MARKED}{INK.reset}" if number in self.marks else " "
        if number in self.evidence:
            return f"{mark}{INK.bad}{EVIDENCE}{INK.reset}"
        return f"{mark}{INK.good}{RELATED}{INK.reset}" if number in self.related else f"{mark} "

    def show_related(self, related: Collection[int]) -> None:
        """Mark the given frames as part of the call under the cursor, and remove earlier such marks."""
        if related != self.related:
            changed = [self.row_of(number) for number in {*related, *self.related}]
            self.related = related
            self.redraw_lines(*(index for index in changed if index is not None))

    def header(self) -> str:
        time = {TimeFormat.UTC: 30, TimeFormat.EPOCH: 20}.get(self.clock, 12)
        client = self.client_header or "  "
        words: Mapping[str, str] = {
            name: label(f"traffic.head.{name}") for name in ("number", "time", "serial", "reserved", "what")
        }
        return (
            f"  {right_aligned(words['number'], 6)} {right_aligned(words['time'], time)} {client}"
            f"{right_aligned(words['serial'], 5)} {right_aligned(words['reserved'], 5)}  {words['what']}"
        )
