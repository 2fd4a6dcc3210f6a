"""Views of traffic: lists of frames and calls, the analysis, and the frame under the cursor."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.widgets import Static

from bcapscope.render.escape import printable
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.call import PairingResult
from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.screens import frame_relations
from bcapscope.tui.screens.base_screen import ViewsScreen
from bcapscope.tui.traffic_processes.process_messages import (
    NO_ANALYSIS,
    ReadProgress,
    SearchMatches,
    TrafficAnalysis,
)
from bcapscope.tui.traffic_processes.traffic_feed import FeedUpdate, SourceProblem, TrafficFeed
from bcapscope.tui.widgets.bars import ViewBar
from bcapscope.tui.widgets.finding_page import FindingPage
from bcapscope.tui.widgets.lines import Lines, TextList
from bcapscope.tui.widgets.packet_view import PacketView
from bcapscope.tui.widgets.plain_containers import PlainVertical, Switcher
from bcapscope.tui.widgets.record_lists import CallList, FrameList, RecordList
from bcapscope.tui.widgets.text_widgets import CheckedInput, InkedText

RECORD_KINDS = {"frames": RecordKind.FRAME, "calls": RecordKind.CALL}
"""Kind of record that the filter of a view tests, for each view that has a filter."""

_NARROW_WIDTH = 100  # on a terminal with fewer columns, large counts are rounded


class TrafficViews(ViewsScreen):
    NAME = "traffic"
    ABOUT = "traffic.about"
    AUTO_FOCUS = "#frames"
    VIEWS: ClassVar[Mapping[str, str]] = {
        view: f"traffic.{view}" for view in ("frames", "calls", "findings", "slave", "statistics")
    }

    def __init__(self, feed: TrafficFeed, title: str) -> None:
        super().__init__()
        self.frames, self.calls = FrameList(id="frames"), CallList(id="calls")
        self.clock = TimeFormat.RELATIVE
        self._generation = 0
        self._set_feed(feed, title)

    def _set_feed(self, feed: TrafficFeed, title: str) -> None:
        self.feed = feed
        self._title = title
        self._source_problem = ""
        self.analysis = NO_ANALYSIS
        self.expressions = dict.fromkeys(RECORD_KINDS, "")
        self._searched = 0
        self._is_problem_shown = False
        self._unsettled_frame: AnnotatedFrame | None = None
        self._shown_frame: int | None = None

    def content(self) -> ComposeResult:
        yield ViewBar(self.VIEWS, id="views")
        yield CheckedInput(
            "filter", self._check_filter, label("traffic.filter.hint"), label("traffic.filter")
        )
        yield InkedText(id="head")
        with Switcher(initial="frames", id="lists"):
            yield self.frames
            yield self.calls
            yield FindingPage(id="findings")
            yield TextList("traffic.empty.slave", id="slave")
            yield TextList("traffic.empty.statistics", id="statistics")
        with PlainVertical(id="detail"):
            yield Static(id="about")
            yield PacketView(id="packet")

    def on_mount(self) -> None:
        app_of(self).closers.callback(self._close_feed)
        for target in (self.frames, self.calls):
            self.watch(target, "cursor", self._cursor_moved, init=False)
        self._subscribe_feed()

    def _subscribe_feed(self) -> None:
        path = self.feed.job.path
        if path and not self.feed.job.follow:
            app, absolute = app_of(self), str(Path(path).absolute())
            self.call_after_refresh(app.add_recent, absolute, app.settings.captures)  # show the traffic first
        self.feed.subscribe(partial(self.call_in_screen, self.show_update, self.feed))
        self.show_state()

    def _close_feed(self) -> None:
        for target in (self.frames, self.calls):
            target.clear_source()
        self.feed.close()

    def replace_feed(self, feed: TrafficFeed, title: str) -> None:
        self._close_feed()
        self._show_analysis(NO_ANALYSIS)
        self._set_feed(feed, title)
        self.action_view("frames")
        self._subscribe_feed()

    # updates

    def show_update(self, feed: TrafficFeed, update: FeedUpdate) -> None:
        if feed is not self.feed or feed.is_closed:
            return
        if isinstance(update, ReadProgress):
            self._show_progress(update)
        elif isinstance(update, TrafficAnalysis):
            self._show_analysis(update)
        elif isinstance(update, SourceProblem):
            self._source_problem = update.reason
        elif update.generation == self._generation:
            self._add_matches(update)
        self.show_state()

    def _show_progress(self, progress: ReadProgress) -> None:
        feed = self.feed
        ended_now = progress.ended and not feed.progress.ended
        feed.progress = progress
        if feed.open_journal() and feed.journal is not None and feed.calls is not None:
            self.frames.open_source(feed.journal, feed.is_live)
            self.calls.open_source(feed.calls, feed.is_live)
            feed.journal.refresh()
            feed.calls.refresh()
            self.update_line_format()
            self._show_growth()
            if self._unsettled_frame is not None:
                self._show_about(self._unsettled_frame)
        if progress.ended and progress.problem and not self._is_problem_shown:
            self._is_problem_shown = True
            app_of(self).show_message(label("traffic.reading-ended", reason=progress.problem), "warning")
        if ended_now:
            self.refresh_bindings()

    def _show_growth(self) -> None:
        if isinstance(self.shown_list, RecordList):
            self.shown_list.lines_added()

    def _show_analysis(self, analysis: TrafficAnalysis) -> None:
        self.analysis = analysis
        self.query_one(FindingPage).show_analysis(analysis)
        self.query_one("#slave", TextList).show_items(analysis.slave_sessions)
        self.query_one("#statistics", TextList).show_items(analysis.statistics)

    def _add_matches(self, matches: SearchMatches) -> None:
        self._searched = matches.searched
        rows = array("I")
        rows.frombytes(matches.rows)
        target = self.shown_list
        if isinstance(target, RecordList) and rows and target.matches is not None:
            target.matches.extend(rows)
            target.lines_added()

    # display

    def update_line_format(self) -> None:
        journal = self.feed.journal
        first = journal.time_of(1) if journal is not None and len(journal) else 0
        several = self.feed.progress.clients > 1
        self.frames.set_line_format(self.clock, several, first)
        self.calls.set_line_format(self.clock, several, first)
        self.show_header()

    def show_state(self) -> None:
        journal, calls, brief = self.feed.journal, self.feed.calls, self.size.width < _NARROW_WIDTH
        counts = {"findings": str(len(self.analysis.findings) or "")}
        if journal is not None and calls is not None:
            counts |= {"frames": count_text(len(journal), brief), "calls": count_text(len(calls), brief)}
            target = self.shown_list
            if isinstance(target, RecordList) and target.matches is not None:
                counts[self.view] = f"{count_text(len(target.matches), brief)}/{counts[self.view]}"
        states = progress_texts(self.feed.progress, self._source_problem, self._search_percent(), self._title)
        self.query_one(ViewBar).show_counts(self.view, counts, states)

    def _search_percent(self) -> int | None:
        source = {"frames": self.feed.journal, "calls": self.feed.calls}.get(self.view)
        if source is None or not self.expressions[self.view] or self._searched >= len(source):
            return None
        return 100 * self._searched // len(source)

    @on(Lines.Moved)
    def _list_moved(self, message: Lines.Moved) -> None:
        if message.lines is self.shown_list:
            self._cursor_moved()

    def _cursor_moved(self) -> None:
        """Show the selected frame at once, so that Textual draws list and frame together."""
        if self.view in RECORD_KINDS and self.frame_number != self._shown_frame:
            self.show_frame()

    @property
    def frame_number(self) -> int | None:
        if self.view == "calls":
            current = self.calls.current_call
            return None if current is None else current[1]
        return self.frames.frame_number if self.view == "frames" else None

    def settled_at(self, number: int) -> PairingResult | None:
        """Return the call or stray reply to which a frame belongs; None while that call is not complete."""
        calls = self.feed.calls
        row = None if calls is None else calls.index_of_frame(number)
        return None if calls is None or row is None else calls.read_call(row).settled

    def show_frame(self) -> None:
        number = self._shown_frame = self.frame_number
        packet = self.query_one(PacketView)
        if number is None:
            packet.show_packet(None)
            self.query_one("#about", Static).update("", layout=False)
            return
        frame = self.frames.source.read_frame(number)
        packet.show_packet(frame.observation, frame.call_kind)
        self._show_about(frame)

    def _show_about(self, frame: AnnotatedFrame) -> None:
        number = frame.observation.number
        settled = self.settled_at(number)
        self._unsettled_frame = frame if settled is None else None
        self.frames.show_related(frame_relations.call_frames(settled))
        about = frame_relations.frame_description(frame, settled, self.frames.marks.get(number))
        self.query_one("#about", Static).update(Text(about, no_wrap=True, overflow="ellipsis"), layout=False)

    # views and filter

    def show_view(self) -> None:
        of_frames = self.view in RECORD_KINDS
        for name in ("#filter-line", "#head", "#detail"):
            self.query_one(name).display = of_frames
        if of_frames:
            self.query_one(CheckedInput).set_text(self.expressions[self.view])
            self._search()
            self._show_growth()
            self.update_line_format()
            self.show_frame()

    def _check_filter(self, expression: str) -> object:
        return compile_filter(expression, RECORD_KINDS.get(self.view, RecordKind.FRAME))

    def set_filter(self, expression: str) -> None:
        """Apply a filter expression to the visible list; "" shows all rows."""
        self.query_one(CheckedInput).set_text(expression)
        self._apply_filter(expression)

    @on(CheckedInput.Typed)
    def _filter_typed(self, message: CheckedInput.Typed) -> None:
        self._apply_filter(message.text)

    @on(CheckedInput.Entered)
    def _filter_entered(self) -> None:
        self.set_focus(self.shown_list)

    def _apply_filter(self, expression: str) -> None:
        if self.view in RECORD_KINDS and expression != self.expressions[self.view]:
            self.expressions[self.view] = expression
            self._search()

    def _search(self) -> None:
        target, expression = self.shown_list, self.expressions[self.view]
        if not isinstance(target, RecordList):
            return
        here = self.frame_number if target is self.frames else None
        was_filtered = target.matches is not None
        self._searched = 0
        self._generation = self.feed.search(RECORD_KINDS[self.view], expression)
        if not expression and not was_filtered:
            return
        target.matches = array("I") if expression else None
        if isinstance(target, CallList):
            target.show_rows()
        else:
            target.reset_lines(target.nearest_row(here) if here is not None and not expression else 0)
        self.show_state()


_BAR = 12


def progress_texts(
    progress: ReadProgress, source_problem: str, searched: int | None, title: str
) -> tuple[str, ...]:
    """Return several texts about the progress of reading and searching, each shorter than the previous one.
    `searched` is the percentage of rows that the search has examined; None if the search is complete.
    """
    long, short = [], []
    if searched is not None:
        long.append(label("traffic.searching", percent=searched))
        short.append(f"/{searched}%")
    if progress.lost:
        long.append(label("traffic.lost", count=progress.lost))
    if source_problem:
        long.append(f"○ {printable(source_problem)}")
        short.append(f"○ {label('traffic.ended')}")
    elif not progress.ended and progress.size:
        percent = 100 * progress.position // progress.size
        full = _BAR * percent // 100
        long.append(f"{label('traffic.reading')} {'━' * full}{'╌' * (_BAR - full)} {percent:>3} %")
        short.append(f"{percent}%")
    elif not progress.ended:
        long.append(f"● {label('traffic.live')}")
        short.append("●")
    return "  ".join((*long, printable(title))), "  ".join(long), " ".join(short)


def count_text(number: int, brief: bool) -> str:
    """Return a count as text. If `brief`, write 10,000 or more as ``12k`` or ``1.2M``, rounded down."""
    if not brief or number < 10_000:
        return f"{number:,}"
    return f"{number // 1000}k" if number < 1_000_000 else f"{number // 100_000 / 10}M"
