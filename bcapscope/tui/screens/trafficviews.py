"""What is shown of traffic: frames, calls, what is thought of them, and the frame under the cursor."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.events import Resize
from textual.message import Message
from textual.widgets import Static

from bcapscope.render.escape import printable
from bcapscope.render.moment import Clock
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import compile_filter
from bcapscope.traffic.getters import Told
from bcapscope.tui.app import scope_of
from bcapscope.tui.screens import following
from bcapscope.tui.screens.progress import count, states
from bcapscope.tui.screens.views import Views
from bcapscope.tui.settings import remembered
from bcapscope.tui.traffic.feed import Doubt, Feed, News
from bcapscope.tui.traffic.report import NOTHING, Matches, Progress, Verdict
from bcapscope.tui.widgets.calllist import CallList
from bcapscope.tui.widgets.checkedline import CheckedLine
from bcapscope.tui.widgets.findingpage import FindingPage
from bcapscope.tui.widgets.framelist import FrameList
from bcapscope.tui.widgets.ground import Deck, Stack
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.packet import PacketView
from bcapscope.tui.widgets.page import Page
from bcapscope.tui.widgets.viewbar import ViewBar
from bcapscope.tui.words import say
from bcapscope.tui.words import told as spoken

KINDS = {"frames": RecordKind.FRAME, "calls": RecordKind.CALL}
"""Views of which each line is a frame, or stands for one, by what their filter tells of."""

_BRIEF = 100
"""Columns below which large counts are rounded."""


class Heard(Message):
    """One of the processes of a feed told something."""

    def __init__(self, feed: Feed, told: News) -> None:
        super().__init__()
        self.feed = feed
        self.told = told


class TrafficViews(Views):
    """Shows what a feed reads.

    Attributes:
        feed: what is shown.
        clock: how the time is told.
    """

    NAME = "traffic"
    ABOUT = "traffic.about"
    AUTO_FOCUS = "#frames"
    VIEWS: ClassVar[Mapping[str, str]] = {
        "frames": "traffic.frames",
        "calls": "traffic.calls",
        "findings": "traffic.findings",
        "slave": "traffic.slave",
        "statistics": "traffic.statistics",
    }

    def __init__(self, feed: Feed, title: str) -> None:
        """Take what is read, and its name for people."""
        super().__init__()
        self.clock = Clock.RELATIVE
        self._generation = 0
        self._head = ""
        self._take(feed, title)

    def _take(self, feed: Feed, title: str) -> None:
        """Begin with a feed of which nothing is known yet."""
        self.feed = feed
        self._title = title
        self._doubt = ""
        self.verdict = NOTHING
        self.expressions = dict.fromkeys(KINDS, "")
        self._searched = 0
        self._trouble_told = False
        self._unsettled: Told | None = None
        self._shown: int | None = None

    def content(self) -> ComposeResult:
        """Yield the views, and below them the frame under the cursor."""
        yield self.bar()
        yield CheckedLine("filter", self._check, say("traffic.filter.hint"), say("traffic.filter"))
        yield Static(id="head")
        with Deck(initial="frames", id="lists"):
            yield FrameList(id="frames")
            yield CallList(id="calls")
            yield FindingPage(id="findings")
            yield Page([say("traffic.empty.slave")], id="slave")
            yield Page([say("traffic.empty.statistics")], id="statistics")
        with Stack(id="detail"):
            yield Static(id="about")
            yield PacketView(id="packet")

    def on_mount(self) -> None:
        """Begin to listen."""
        scope_of(self).at_close(self._close)
        for target in (self.frames, self.calls):
            self.watch(target, "cursor", self._cursor_moved, init=False)
        self._listen()

    def _listen(self) -> None:
        path = self.feed.job.path
        if path and not self.feed.job.follow:
            settings = scope_of(self).settings
            settings.captures = remembered(str(Path(path).absolute()), settings.captures)
            self.call_after_refresh(scope_of(self).keep)  # what is read is shown first
        self.feed.attach(partial(self._hear, self.feed))
        self.show_state()

    def _hear(self, feed: Feed, told: News) -> None:
        """Take what is told in another thread."""
        self.post_message(Heard(feed, told))

    async def _close(self) -> None:
        self._let_go()

    def _let_go(self) -> None:
        """Close the feed; nothing that is shown or still to be heard needs it any more."""
        for target in (self.frames, self.calls):
            target.forget()
        self.feed.close()

    def replace(self, feed: Feed, title: str) -> None:
        """Show another feed instead."""
        self._let_go()
        self._judged(NOTHING)
        self._take(feed, title)
        self.action_view("frames")
        self._listen()

    # what is told

    def on_heard(self, message: Heard) -> None:
        """Take in what one of the processes told."""
        message.stop()
        told = message.told
        if message.feed is not self.feed or message.feed.is_closed:
            return
        if isinstance(told, Progress):
            self._progressed(told)
        elif isinstance(told, Verdict):
            self._judged(told)
        elif isinstance(told, Doubt):
            self._doubt = told.why
        elif told.generation == self._generation:
            self._matched(told)
        self.show_state()

    def _progressed(self, told: Progress) -> None:
        feed = self.feed
        ended_now = told.ended and not feed.progress.ended
        feed.progress = told
        if feed.open() and feed.journal is not None and feed.calls is not None:
            self.frames.open(feed.journal, feed.is_live)
            self.calls.open(feed.calls, feed.is_live)
            feed.journal.refresh()
            feed.calls.refresh()
            self.look()
            self._grown()
            if self._unsettled is not None:
                self._show_about(self._unsettled)
        if told.ended and told.trouble and not self._trouble_told:
            self._trouble_told = True
            scope_of(self).tell(say("traffic.trouble", reason=printable(spoken(told.trouble))), "warning")
        if ended_now:
            self.refresh_bindings()

    def _grown(self) -> None:
        """Show that there is more in the list that is seen; the other one is asked when it is shown."""
        target = self.seen
        if isinstance(target, FrameList | CallList):
            target.grown()

    def _judged(self, told: Verdict) -> None:
        self.verdict = told
        self.query_one(FindingPage).show(told)
        self.query_one("#slave", Page).show(told.stays or [say("traffic.empty.slave")])
        self.query_one("#statistics", Page).show(told.statistics or [say("traffic.empty.statistics")])

    def _matched(self, told: Matches) -> None:
        self._searched = told.searched
        rows = array("I")
        rows.frombytes(told.rows)
        target = self.seen
        if isinstance(target, FrameList | CallList) and rows and target.rows.found is not None:
            target.rows.found.extend(rows)
            target.grown()

    # what is shown

    @property
    def frames(self) -> FrameList:
        """The list of frames."""
        return self.query_one(FrameList)

    @property
    def calls(self) -> CallList:
        """The list of calls."""
        return self.query_one(CallList)

    def look(self) -> None:
        """Tell times, and name clients where there are several."""
        journal = self.feed.journal
        first = journal.time(1) if journal is not None and len(journal) else 0
        several = self.feed.progress.clients > 1
        self.frames.look(self.clock, several)
        self.calls.look(self.clock, several, first)
        head = {"frames": self.frames.head, "calls": self.calls.head}.get(self.view)
        text = "" if head is None else head()
        if text != self._head:
            self._head = text
            self.query_one("#head", Static).update(Text(text), layout=False)

    def show_state(self) -> None:
        """Show how much there is, and how reading and searching go."""
        journal, calls, brief = self.feed.journal, self.feed.calls, self.size.width < _BRIEF
        counts = {"findings": str(len(self.verdict.findings) or "")}
        if journal is not None and calls is not None:
            counts |= {"frames": count(len(journal), brief), "calls": count(len(calls), brief)}
            target = self.seen
            if isinstance(target, FrameList | CallList) and target.rows.found is not None:
                counts[self.view] = f"{count(len(target.rows.found), brief)}/{counts[self.view]}"
        told = states(self.feed.progress, self._doubt, self._percent(), self._title)
        self.query_one(ViewBar).show(self.view, counts, told)

    def _percent(self) -> int | None:
        """Tell how much of what is there was searched; None where there is nothing left to search."""
        source = {"frames": self.feed.journal, "calls": self.feed.calls}.get(self.view)
        if source is None or not self.expressions[self.view] or self._searched >= len(source):
            return None
        return 100 * self._searched // len(source)

    @on(Lines.Moved)
    def _moved(self, message: Lines.Moved) -> None:
        """Show the frame under the cursor, where others are listed than before."""
        if message.lines is self.seen:
            self._cursor_moved()

    def _cursor_moved(self) -> None:
        """Show the frame under the cursor; called at once, so that list and frame are drawn together."""
        if self.view in KINDS and self.number != self._shown:
            self.show_frame()

    @property
    def number(self) -> int | None:
        """Number of the frame under the cursor; None where there is none."""
        if self.view == "calls":
            current = self.calls.current
            return None if current is None else current[1]
        return self.frames.number if self.view == "frames" else None

    def show_frame(self) -> None:
        """Show the frame under the cursor below the list."""
        number, calls = self.number, self.feed.calls
        self._shown = number
        packet = self.query_one(PacketView)
        if number is None or calls is None:
            packet.show(None)
            self.query_one("#about", Static).update("", layout=False)
            return
        told = self.frames.told(number)
        packet.show(told.seen, told.question)
        self._show_about(told)

    def _show_about(self, told: Told) -> None:
        """Tell which call a frame belongs to, as soon as that has settled."""
        calls, number = self.feed.calls, told.seen.number
        if calls is None:
            return
        row = calls.row_of(number)
        self._unsettled = told if row is None else None
        settled = None if row is None else calls.row(row).settled
        self.frames.relate(following.frames_of(settled))
        about = following.about(told, settled, self.frames.marks.get(number))
        self.query_one("#about", Static).update(Text(about, no_wrap=True, overflow="ellipsis"), layout=False)

    def on_resize(self, event: Resize) -> None:
        """Give the frame what the list can spare."""
        height = event.size.height
        self.query_one("#detail").styles.height = max(8, min(26, height * 2 // 5))

    # views and filter

    def show_view(self) -> None:
        """Show the filter and the frame where there are frames."""
        of_frames = self.view in KINDS
        for name in ("#filter-line", "#head", "#detail"):
            self.query_one(name).display = of_frames
        if of_frames:
            self.query_one(CheckedLine).propose(self.expressions[self.view])
            self._search()
            self._grown()
            self.look()
            self.show_frame()

    def _check(self, expression: str) -> object:
        """Make a filter for the view, as a check."""
        return compile_filter(expression, KINDS.get(self.view, RecordKind.FRAME))

    def set_filter(self, expression: str) -> None:
        """Show only what an expression is true for; "" for all."""
        self.query_one(CheckedLine).propose(expression)
        self._filter(expression)

    @on(CheckedLine.Typed)
    def _typed(self, message: CheckedLine.Typed) -> None:
        """Search for what was typed at once."""
        self._filter(message.text)

    @on(CheckedLine.Entered)
    def _entered(self) -> None:
        """Go from the filter to what it lets pass."""
        self.set_focus(self.seen)

    def _filter(self, expression: str) -> None:
        if self.view in KINDS and expression != self.expressions[self.view]:
            self.expressions[self.view] = expression
            self._search()

    def _search(self) -> None:
        """Search for the expression of this view from the start, or show all."""
        target, expression = self.seen, self.expressions[self.view]
        if not isinstance(target, FrameList | CallList):
            return
        here = self.number if target is self.frames else None
        was_filtered = target.rows.found is not None
        self._searched = 0
        self._generation = self.feed.ask(KINDS[self.view], expression)
        if not expression and not was_filtered:
            return
        target.rows.found = array("I") if expression else None
        if isinstance(target, CallList):
            target.show_rows()
        else:
            target.changed(target.rows.nearest(here) if here is not None and not expression else 0)
        self.show_state()
