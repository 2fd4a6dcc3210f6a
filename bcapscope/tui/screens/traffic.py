"""Traffic: frames, calls, findings, slave mode and statistics of a file, an interface or another screen."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.events import Resize
from textual.message import Message
from textual.widgets import ContentSwitcher, Input, Static

from bcapscope.render.escape import printable
from bcapscope.render.moment import Clock
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import FilterError, compile_filter
from bcapscope.traffic.getters import Told
from bcapscope.tui.app import scope_of
from bcapscope.tui.screens import following
from bcapscope.tui.screens.place import Place
from bcapscope.tui.screens.prompt import Prompt
from bcapscope.tui.settings import remembered
from bcapscope.tui.traffic.feed import Feed
from bcapscope.tui.traffic.report import Matches, Progress, Verdict
from bcapscope.tui.widgets.calllist import CallList
from bcapscope.tui.widgets.findingpage import FindingPage
from bcapscope.tui.widgets.framelist import FrameList
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.packet import PacketView
from bcapscope.tui.widgets.page import Page
from bcapscope.tui.widgets.viewbar import ViewBar
from bcapscope.tui.words import say

VIEWS = ("frames", "calls", "findings", "slave", "statistics")
_BRIEF = 100
"""Columns below which large counts are rounded."""

_BAR = 12
_OF_FRAMES = frozenset({"filter", "partner", "call", "mark", "note", "clock", "goto", "follow"})
_CLOCKS = (Clock.RELATIVE, Clock.DELTA, Clock.UTC)
_KINDS = {"frames": RecordKind.FRAME, "calls": RecordKind.CALL}


class Heard(Message):
    """One of the processes of a feed told something."""

    def __init__(self, feed: Feed, told: Progress | Verdict | Matches) -> None:
        super().__init__()
        self.feed = feed
        self.told = told


class TrafficScreen(Place):
    """Shows what a feed reads."""

    NAME = "traffic"
    ABOUT = "traffic.about"
    AUTO_FOCUS = "#frames"
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(f"{number}", f"view('{view}')", f"traffic.{view}", show=False, tooltip="traffic.view.tip")
            for number, view in enumerate(VIEWS, 1)
        ),
        Binding(
            "slash",
            "filter",
            "traffic.filter",
            id="traffic.filter",
            key_display="/",
            tooltip="traffic.filter.tip",
        ),
        Binding("escape", "back", "traffic.back", id="traffic.back", show=False, tooltip="traffic.back.tip"),
        Binding("r", "partner", "traffic.partner", id="traffic.partner", tooltip="traffic.partner.tip"),
        Binding("c", "call", "traffic.call", id="traffic.call", tooltip="traffic.call.tip"),
        Binding("w", "why", "traffic.why", id="traffic.why", tooltip="traffic.why.tip"),
        Binding("n", "proof(1)", "traffic.next", id="traffic.next", tooltip="traffic.next.tip"),
        Binding(
            "N",
            "proof(-1)",
            "traffic.previous",
            id="traffic.previous",
            show=False,
            tooltip="traffic.previous.tip",
        ),
        Binding("m", "mark", "traffic.mark", id="traffic.mark", tooltip="traffic.mark.tip"),
        Binding("e", "note", "traffic.note", id="traffic.note", tooltip="traffic.note.tip"),
        Binding("s", "save", "traffic.save", id="traffic.save", tooltip="traffic.save.tip"),
        Binding("o", "open", "traffic.open", id="traffic.open", show=False, tooltip="traffic.open.tip"),
        Binding("t", "clock", "traffic.clock", id="traffic.clock", show=False, tooltip="traffic.clock.tip"),
        Binding("ctrl+g", "goto", "traffic.goto", id="traffic.goto", show=False, tooltip="traffic.goto.tip"),
        Binding(
            "C", "follow('client')", "traffic.follow.client", show=False, tooltip="traffic.follow.client.tip"
        ),
        Binding(
            "H", "follow('handle')", "traffic.follow.handle", show=False, tooltip="traffic.follow.handle.tip"
        ),
        Binding(
            "X", "follow('chain')", "traffic.follow.chain", show=False, tooltip="traffic.follow.chain.tip"
        ),
        Binding("K", "follow('kind')", "traffic.follow.kind", show=False, tooltip="traffic.follow.kind.tip"),
        Binding("S", "stop", "traffic.stop", id="traffic.stop", show=False, tooltip="traffic.stop.tip"),
    ]

    def __init__(self, feed: Feed, title: str) -> None:
        """Take what is read, and its name for people."""
        super().__init__()
        self._view = "frames"
        self._clock = Clock.RELATIVE
        self._generation = 0
        self._take(feed, title)

    def _take(self, feed: Feed, title: str) -> None:
        """Begin with a feed of which nothing is known yet."""
        self._feed = feed
        self._title = title
        self._verdict = Verdict((), "", [], [])
        self._expressions = dict.fromkeys(_KINDS, "")
        self._searched = 0
        self._proofs: list[int] = []
        self._trouble_told = False
        self._unsettled: Told | None = None
        self._shown: int | None = None

    def content(self) -> ComposeResult:
        """Yield the views, and below them the frame under the cursor."""
        yield ViewBar([(view, f"traffic.{view}") for view in VIEWS], id="views")
        with Vertical(id="filter-box"):
            with Horizontal(id="filter-row"):
                yield Static(Text(f" {say('traffic.filter')} "), id="filter-label")
                yield Input(placeholder=say("traffic.filter.hint"), id="filter")
            yield Static(id="filter-error")
        yield Static(id="head")
        with ContentSwitcher(initial="frames", id="lists"):
            yield FrameList(id="frames")
            yield CallList(id="calls")
            yield FindingPage(id="findings")
            yield Page([say("traffic.empty.slave")], id="slave")
            yield Page([say("traffic.empty.statistics")], id="statistics")
        with Vertical(id="detail"):
            yield Static(id="about")
            yield PacketView(id="packet")

    def on_mount(self) -> None:
        """Begin to listen."""
        scope_of(self).at_close(self._close)
        for target in (self.frames, self.calls):
            self.watch(target, "cursor", self._cursor_moved, init=False)
        self._listen()

    def _listen(self) -> None:
        path = self._feed.job.path
        if path and not self._feed.job.follow:
            settings = scope_of(self).settings
            settings.captures = remembered(str(Path(path).absolute()), settings.captures)
            scope_of(self).keep()
        self._feed.attach(partial(self._hear, self._feed))
        self._show_state()

    def _hear(self, feed: Feed, told: Progress | Verdict | Matches) -> None:
        """Take what is told in another thread."""
        self.post_message(Heard(feed, told))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer what has to do with a frame only where there is one, to stop only what goes on."""
        if action in _OF_FRAMES:
            return self._view in _KINDS
        if action == "proof":
            return bool(self._proofs)
        going_on = self._feed.is_live and not self._feed.progress.ended
        if action in ("stop", "open"):
            return going_on == (action == "stop")
        return True

    async def _close(self) -> None:
        self._let_go()

    def _let_go(self) -> None:
        """Close the feed; nothing that is shown or still to be heard needs it any more."""
        for target in (self.frames, self.calls):
            target.forget()
        self._feed.close()

    # what is told

    def on_heard(self, message: Heard) -> None:
        """Take in what one of the processes told."""
        message.stop()
        told = message.told
        if message.feed is not self._feed or message.feed.is_closed:
            return
        if isinstance(told, Progress):
            self._progressed(told)
        elif isinstance(told, Verdict):
            self._judged(told)
        elif told.generation == self._generation:
            self._matched(told)
        self._show_state()

    def _progressed(self, told: Progress) -> None:
        feed = self._feed
        feed.progress = told
        if feed.open() and feed.journal is not None and feed.calls is not None:
            self.frames.open(feed.journal, feed.is_live)
            self.calls.open(feed.calls, feed.is_live)
            feed.journal.refresh()
            feed.calls.refresh()
            self._look()
            self._grown()
            if self._unsettled is not None:
                self._show_about(self._unsettled)
        if told.ended and told.trouble and not self._trouble_told:
            self._trouble_told = True
            scope_of(self).tell(say("traffic.trouble", reason=printable(told.trouble)), "warning")

    def _grown(self) -> None:
        """Show that there is more in the list that is seen; the other one is asked when it is shown."""
        target = self._list
        if isinstance(target, FrameList | CallList):
            target.grown()

    def _judged(self, told: Verdict) -> None:
        self._verdict = told
        self.query_one(FindingPage).show(told.findings, told.sum)
        self.query_one("#slave", Page).show(told.stays or [say("traffic.empty.slave")])
        self.query_one("#statistics", Page).show(told.statistics or [say("traffic.empty.statistics")])

    def _matched(self, told: Matches) -> None:
        self._searched = told.searched
        rows = array("I")
        rows.frombytes(told.rows)
        target = self._list
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

    @property
    def _list(self) -> Lines:
        found = self.query_one(f"#{self._view}")
        assert isinstance(found, Lines)
        return found

    def _look(self) -> None:
        journal = self._feed.journal
        first = journal.time(1) if journal is not None and len(journal) else 0
        several = self._feed.progress.clients > 1
        self.frames.look(self._clock, several)
        self.calls.look(self._clock, several, first)
        head = {"frames": self.frames.head, "calls": self.calls.head}.get(self._view)
        self.query_one("#head", Static).update(Text(head() if head is not None else ""), layout=False)

    def _show_state(self) -> None:
        feed, brief = self._feed, self.size.width < _BRIEF
        counts = {"findings": str(len(self._verdict.findings) or "")}
        if feed.journal is not None and feed.calls is not None:
            counts |= {
                "frames": _count(len(feed.journal), brief),
                "calls": _count(len(feed.calls), brief),
            }
            target = self._list
            if isinstance(target, FrameList | CallList) and target.rows.found is not None:
                counts[self._view] = f"{_count(len(target.rows.found), brief)}/{counts[self._view]}"
        self.query_one(ViewBar).show(self._view, counts, self._states())

    def _states(self) -> tuple[str, ...]:
        """Say how reading and searching go, in full and, for narrow terminals, in short."""
        told, long, short = self._feed.progress, [], []
        if self._expressions.get(self._view) and self._feed.journal is not None:
            source = self._feed.journal if self._view == "frames" else self._feed.calls
            there = len(source) if source is not None else 0
            if self._searched < there:
                percent = 100 * self._searched // there
                long.append(say("traffic.searching", percent=percent))
                short.append(f"/{percent}%")
        if told.lost:
            long.append(say("traffic.lost", count=told.lost))
        if not told.ended and told.size:
            percent = 100 * told.position // told.size
            long.append(f"{say('traffic.reading')} {_bar(percent)} {percent:>3} %")
            short.append(f"{percent}%")
        elif not told.ended:
            long.append(f"● {say('traffic.live')}")
            short.append("●")
        return "  ".join((*long, printable(self._title))), "  ".join(long), " ".join(short)

    @on(Lines.Moved)
    def _moved(self, message: Lines.Moved) -> None:
        """Show the frame under the cursor, where others are listed than before."""
        if message.lines is self._list:
            self._cursor_moved()

    def _cursor_moved(self) -> None:
        """Show the frame under the cursor; called at once, so that list and frame are drawn together."""
        if self._view in _KINDS and self._number() != self._shown:
            self._show_frame()

    def _number(self) -> int | None:
        """Number of the frame under the cursor."""
        if self._view == "calls":
            current = self.calls.current
            return None if current is None else current[1]
        return self.frames.number if self._view == "frames" else None

    def _show_frame(self) -> None:
        number, calls = self._number(), self._feed.calls
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
        calls, number = self._feed.calls, told.seen.number
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

    @on(ViewBar.Wanted)
    def _wanted(self, message: ViewBar.Wanted) -> None:
        self.action_view(message.view)

    def action_view(self, view: str) -> None:
        """Show another view."""
        self._view = view
        self.query_one(ContentSwitcher).current = view
        filtered = view in _KINDS
        self.query_one("#filter-box").display = filtered
        self.query_one("#head").display = filtered
        self.query_one("#detail").display = filtered
        if filtered:
            field = self.query_one("#filter", Input)
            with field.prevent(Input.Changed):
                field.value = self._expressions[view]
            self._search()
            self._grown()
            self._look()
            self._show_frame()
        self._list.focus()
        self.refresh_bindings()
        self._show_state()

    def action_filter(self) -> None:
        """Go to the filter."""
        self.query_one("#filter", Input).focus()

    def action_back(self) -> None:
        """Go from the filter to the list; from the list, end the filter."""
        if self._list.has_focus and self._expressions.get(self._view):
            self.set_filter("")
        self._list.focus()

    def set_filter(self, expression: str) -> None:
        """Show only what an expression is true for; "" for all."""
        self.query_one("#filter", Input).value = expression

    @on(Input.Submitted, "#filter")
    def _submitted(self) -> None:
        self._list.focus()

    @on(Input.Changed, "#filter")
    def _typed(self, event: Input.Changed) -> None:
        """Check what was typed, and search for it at once."""
        expression = event.value.strip()
        if self._view not in _KINDS or expression == self._expressions[self._view]:
            return
        error = self.query_one("#filter-error", Static)
        try:
            if expression:
                compile_filter(expression, _KINDS[self._view])
        except FilterError as wrong:
            error.update(Text(str(wrong)))
            error.display = True
            event.input.add_class("-invalid")
            return
        error.display = False
        event.input.remove_class("-invalid")
        self._expressions[self._view] = expression
        self._search()

    def _search(self) -> None:
        """Search for the expression of this view from the start, or show all."""
        target, expression = self._list, self._expressions[self._view]
        if not isinstance(target, FrameList | CallList):
            return
        here = self._number() if target is self.frames else None
        was_filtered = target.rows.found is not None
        self._searched = 0
        self._generation = self._feed.ask(_KINDS[self._view], expression)
        if not expression and not was_filtered:
            return
        target.rows.found = array("I") if expression else None
        if isinstance(target, CallList):
            target.show_rows()
        else:
            target.changed(target.rows.nearest(here) if here is not None and not expression else 0)
        self._show_state()

    def action_clock(self) -> None:
        """Tell the time in another way."""
        self._clock = _CLOCKS[(_CLOCKS.index(self._clock) + 1) % len(_CLOCKS)]
        self._look()

    # going places

    def go_to_frame(self, number: int) -> None:
        """Show a frame in the list of frames, ending a filter that hides it."""
        if self._view != "frames":
            self.action_view("frames")
        index = self.frames.rows.index(number)
        if index is None:
            self.set_filter("")
            self._expressions["frames"] = ""
            self._search()
            scope_of(self).tell(say("traffic.hidden", number=number))
            index = number - 1
        self.frames.go(index)

    def action_partner(self) -> None:
        """Go from a reply to its request, and back."""
        number, calls = self._number(), self._feed.calls
        if number is None or calls is None:
            return
        row = calls.row_of(number)
        other, why = following.partner(None if row is None else calls.row(row).settled, number)
        if other is None:
            scope_of(self).tell(say(why))
        else:
            self.go_to_frame(other)

    def action_call(self) -> None:
        """Go from a frame to its call, and back."""
        number, calls = self._number(), self._feed.calls
        if number is None or calls is None:
            return
        if self._view == "calls":
            self.go_to_frame(number)
            return
        row = calls.row_of(number)
        if row is None:
            scope_of(self).tell(say("traffic.no_call"))
            return
        self.action_view("calls")
        if not self.calls.go_to(row + 1):
            self.set_filter("")
            self._expressions["calls"] = ""
            self._search()
            self.calls.go_to(row + 1)

    def action_why(self) -> None:
        """Go to the finding that names this frame; from a finding to its cause."""
        page, findings = self.query_one(FindingPage), self._verdict.findings
        if self._view == "findings":
            number = page.finding()
            cause = findings[number - 1].consequence_of if number is not None else 0
            if cause:
                page.go_to(cause)
            else:
                scope_of(self).tell(say("traffic.no_cause"))
            return
        frame, calls = self._number(), self._feed.calls
        if frame is None or calls is None:
            return
        row = calls.row_of(frame)
        frames = {frame} if row is None else {frame, *following.frames_of(calls.row(row).settled)}
        for number, cause_found in enumerate(findings, 1):
            if frames.intersection(cause_found.frames):
                self.action_view("findings")
                page.go_to(number)
                return
        scope_of(self).tell(say("traffic.no_finding"))

    @on(FindingPage.Chosen)
    def _chosen(self, message: Lines.Chosen) -> None:
        """Go to the first frame that proves a finding; from a frame to its fields."""
        if isinstance(message.lines, FindingPage):
            number = message.lines.finding()
            if number is not None and self._verdict.findings[number - 1].frames:
                self._proofs = list(self._verdict.findings[number - 1].frames)
                self.refresh_bindings()
                self.frames.proofs = frozenset(self._proofs)
                self.frames.repaint()
                self.go_to_frame(self._proofs[0])
        elif message.lines is self.frames:
            self.query_one("#fields").focus()
        elif message.lines is self.calls:
            number = self._number()
            if number is not None:
                self.go_to_frame(number)

    def action_proof(self, by: int) -> None:
        """Go to another frame that proves the finding chosen."""
        number = self._number()
        if by > 0:
            later = [each for each in self._proofs if number is None or each > number]
            self.go_to_frame((later or self._proofs)[0])
        else:
            earlier = [each for each in self._proofs if number is None or each < number]
            self.go_to_frame((earlier or self._proofs)[-1])

    def action_follow(self, what: str) -> None:
        """Show only what has to do with the frame under the cursor."""
        number, calls = self._number(), self._feed.calls
        if number is None or calls is None:
            return
        row = calls.row_of(number)
        found = following.expression(
            what, self.frames.told(number), None if row is None else calls.row(row).settled
        )
        if found is None:
            scope_of(self).tell(say("traffic.no_handle" if what == "handle" else "traffic.no_call"))
            return
        view = {"handle": "calls", "chain": "frames"}.get(what, self._view)
        if view != self._view:
            self.action_view(view)
        self.set_filter(found)

    @work
    async def action_goto(self) -> None:
        """Ask for a frame or a moment, and go there."""
        journal = self._feed.journal
        answer = await self.app.push_screen_wait(Prompt(say("traffic.goto.title"), say("traffic.goto.hint")))
        if not answer or journal is None or not len(journal):
            return
        number = following.frame_at(answer, journal)
        if number is None:
            scope_of(self).tell(say("traffic.goto.wrong", text=printable(answer)), "warning")
        else:
            self.go_to_frame(number)

    # marks, notes, saving

    def action_mark(self) -> None:
        """Mark the frame, or unmark it."""
        number = self._number()
        if number is None:
            return
        if self.frames.marks.pop(number, None) is None:
            self.frames.marks[number] = ""
        self.frames.repaint()
        self._show_frame()

    @work
    async def action_note(self) -> None:
        """Write a note on the frame."""
        number = self._number()
        if number is None:
            return
        title = say("traffic.note.title", number=number)
        prompt = Prompt(title, say("traffic.note.hint"), self.frames.marks.get(number, ""))
        note = await self.app.push_screen_wait(prompt)
        if note is None:
            return
        if note.strip():
            self.frames.marks[number] = note.strip()
        else:
            self.frames.marks.pop(number, None)
        self.frames.repaint()
        self._show_frame()

    @work
    async def action_save(self) -> None:
        """Save the packets with marks and notes in a new file."""
        packets = self._feed.progress.packets
        if not packets or self._feed.journal is None:
            scope_of(self).tell(say("traffic.nothing_to_save"), "warning")
            return
        source = self._feed.name
        proposed = source.with_name(f"{source.name.removesuffix('.gz').rpartition('.')[0]}-notes.pcapng")
        prompt = Prompt(say("traffic.save.title"), say("traffic.save.hint"), str(proposed))
        target = await self.app.push_screen_wait(prompt)
        if target:
            self._save(str(Path(target).expanduser()))

    @work(thread=True)
    def _save(self, target: str) -> None:
        """Wait for the process that saves."""
        shown, tell = printable(target), scope_of(self).tell
        self.app.call_from_thread(tell, say("traffic.saving", path=shown))
        notes = following.notes_by_packet(self.frames.marks, self.frames.told)
        reason = self._feed.save(target, notes)
        if reason:
            text = say("traffic.unsaved", path=shown, reason=printable(reason))
            self.app.call_from_thread(tell, text, "error")
        else:
            self.app.call_from_thread(tell, say("traffic.saved", path=shown))

    def commands(self) -> Iterator[tuple[str, str, str]]:
        """Offer the captures that were opened lately."""
        if self.check_action("open", ()):
            for number, path in enumerate(scope_of(self).settings.captures):
                name = say("traffic.open.recent", path=printable(path))
                yield name, say("traffic.open.tip"), f"open_recent({number})"

    def action_open_recent(self, number: int) -> None:
        """Show a capture that was opened lately instead."""
        self._open(scope_of(self).settings.captures[number])

    @work
    async def action_open(self) -> None:
        """Ask for another capture and show it instead."""
        known = scope_of(self).settings.captures
        folder = f"{Path(known[0]).parent}/" if known else ""
        path = await self.app.push_screen_wait(Prompt(say("traffic.open"), say("traffic.open.hint"), folder))
        if path:
            self._open(str(Path(path).expanduser()))

    def _open(self, path: str) -> None:
        if not Path(path).is_file():
            scope_of(self).tell(say("traffic.open.none", path=printable(path)), "warning")
            return
        self._let_go()
        self._judged(Verdict((), "", [], []))
        self._take(Feed(path=path, ports=self._feed.job.ports), Path(path).name)
        self.action_view("frames")
        self._listen()

    def action_stop(self) -> None:
        """Capture no more."""
        self._feed.stop()


def _count(number: int, brief: bool) -> str:
    """Write a count, in a narrow place rounded down to three digits."""
    if not brief or number < 10_000:
        return f"{number:,}"
    return f"{number // 1000}k" if number < 1_000_000 else f"{number // 100_000 / 10}M"


def _bar(percent: int) -> str:
    """Draw how far reading has come."""
    full = _BAR * percent // 100
    return f"{'━' * full}{'╌' * (_BAR - full)}"
