"""The traffic screen, with keys to navigate, mark, save and open. Also a simulator's traffic screen."""

from __future__ import annotations

import asyncio
import os.path
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import on, work
from textual.binding import Binding, BindingType

from bcapscope.live.child_process import ChildProcess
from bcapscope.render.escape import printable
from bcapscope.render.timestamp import TimeFormat
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import full_error_text, label
from bcapscope.tui.screens import frame_relations
from bcapscope.tui.screens.base_screen import view_keys
from bcapscope.tui.screens.traffic_views import RECORD_KINDS, TrafficViews
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolderError
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from bcapscope.tui.widgets.finding_page import FindingPage
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.text_widgets import CheckedInput

_FRAME_ACTIONS = frozenset({"filter", "partner", "call", "mark", "note", "clock", "goto", "follow"})
_CLOCKS = (TimeFormat.RELATIVE, TimeFormat.DELTA, TimeFormat.UTC)


class TrafficScreen(TrafficViews):
    BINDINGS: ClassVar[list[BindingType]] = [
        *view_keys(TrafficViews.VIEWS, "traffic.view.tip"),
        Binding("slash", "filter", "traffic.filter", key_display="/"),
        Binding("escape", "back", "traffic.back", show=False),
        Binding("r", "partner", "traffic.partner"),
        Binding("c", "call", "traffic.call"),
        Binding("w", "why", "traffic.why"),
        Binding("n", "proof(1)", "traffic.next"),
        Binding("N", "proof(-1)", "traffic.previous", show=False),
        Binding("m", "mark", "traffic.mark"),
        Binding("e", "note", "traffic.note"),
        Binding("s", "save", "traffic.save"),
        Binding("o", "open", "traffic.open", show=False),
        Binding("ctrl+o", "open", "", show=False),
        Binding("t", "clock", "traffic.clock", show=False),
        Binding("ctrl+g", "goto", "traffic.goto", show=False),
        Binding("C", "follow('client')", "traffic.follow.client", show=False),
        Binding("H", "follow('handle')", "traffic.follow.handle", show=False),
        Binding("X", "follow('chain')", "traffic.follow.call", show=False),
        Binding("K", "follow('kind')", "traffic.follow.kind", show=False),
        Binding("S", "stop", "traffic.stop", show=False),
    ]

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        if action in _FRAME_ACTIONS:
            return self.view in RECORD_KINDS
        if action == "proof":
            return bool(self.frames.evidence)
        going_on = self.feed.is_live and not self.feed.progress.ended
        if action in ("stop", "open"):
            return going_on == (action == "stop")
        return True

    # filter and time

    def action_filter(self) -> None:
        self.set_focus(self.query_one("#filter"))

    def action_back(self) -> None:
        """Return from the filter field to the list; from the list, remove the filter."""
        if self.shown_list.has_focus and self.query_one(CheckedInput).field.value:
            self.set_filter("")
        super().action_back()

    def action_clock(self) -> None:
        self.clock = _CLOCKS[(_CLOCKS.index(self.clock) + 1) % len(_CLOCKS)]
        self.update_line_format()

    # navigation

    def go_to_frame(self, number: int) -> None:
        """Select a frame in the list of frames; clear a filter that hides the frame."""
        if self.view != "frames":
            self.action_view("frames")
        index = self.frames.row_of(number)
        if index is None:
            self.set_filter("")
            app_of(self).show_message(label("traffic.hidden", number=number))
            index = number - 1
        self.frames.move_cursor_to(index)

    def action_partner(self) -> None:
        number = self.frame_number
        if number is None:
            return
        other, why = frame_relations.find_partner(self.settled_at(number), number)
        if other is None:
            app_of(self).show_message(label(why))
        else:
            self.go_to_frame(other)

    def action_call(self) -> None:
        """Go from a frame to its call, or from a call to the frame under the cursor."""
        number, calls = self.frame_number, self.feed.calls
        if number is None or calls is None:
            return
        if self.view == "calls":
            self.go_to_frame(number)
            return
        row = calls.index_of_frame(number)
        if row is None:
            app_of(self).show_message(label("traffic.no_call"))
            return
        self.action_view("calls")
        if not self.calls.go_to_call(row + 1):
            self.set_filter("")
            self.calls.go_to_call(row + 1)

    def action_why(self) -> None:
        """Go from a frame to the finding that names it, or from a finding to its cause."""
        page, findings = self.query_one(FindingPage), self.analysis.findings
        if self.view == "findings":
            number = page.current_finding()
            cause = findings[number - 1].consequence_of if number is not None else 0
            if cause:
                page.go_to_finding(cause)
            else:
                app_of(self).show_message(label("traffic.no_cause"))
            return
        frame = self.frame_number
        if frame is None:
            return
        frames = {frame, *frame_relations.call_frames(self.settled_at(frame))}
        for number, cause_found in enumerate(findings, 1):
            if frames.intersection(cause_found.frames):
                self.action_view("findings")
                page.go_to_finding(number)
                return
        app_of(self).show_message(label("traffic.no_finding"))

    @on(FindingPage.Chosen)
    def _line_chosen(self, message: Lines.Chosen) -> None:
        if isinstance(message.lines, FindingPage):
            number = message.lines.current_finding()
            frames = () if number is None else self.analysis.findings[number - 1].frames
            if frames:
                self.frames.evidence = dict.fromkeys(frames)
                self.frames.repaint()
                self.refresh_bindings()
                self.go_to_frame(frames[0])
        elif message.lines is self.frames:
            self.set_focus(self.query_one("#fields"))
        elif message.lines is self.calls:
            number = self.frame_number
            if number is not None:
                self.go_to_frame(number)

    def action_proof(self, by: int) -> None:
        number, frames = self.frame_number, list(self.frames.evidence)[::by]
        beyond = (each for each in frames if number is None or (each - number) * by > 0)
        self.go_to_frame(next(beyond, frames[0]))

    def action_follow(self, what: str) -> None:
        number = self.frame_number
        if number is None:
            return
        frame, settled = self.frames.source.read_frame(number), self.settled_at(number)
        found = frame_relations.related_filter(what, frame, settled)
        if found is None:
            app_of(self).show_message(label("traffic.no_handle" if what == "handle" else "traffic.no_call"))
            return
        view = {"handle": "calls", "chain": "frames"}.get(what, self.view)
        if view != self.view:
            self.action_view(view)
        self.set_filter(found)

    @work
    async def action_goto(self) -> None:
        journal = self.feed.journal
        answer = await self.ask(label("traffic.goto.title"), label("traffic.goto.hint"))
        if not answer or journal is None or not len(journal):
            return
        number = frame_relations.find_frame(answer, journal)
        if number is None:
            app_of(self).show_message(label("traffic.goto.wrong", text=printable(answer)), "warning")
        else:
            self.go_to_frame(number)

    # marks, notes, saving

    def action_mark(self) -> None:
        number = self.frame_number
        if number is not None:
            self._set_note(number, None if number in self.frames.marks else "")

    def _set_note(self, number: int, note: str | None) -> None:
        """Mark a frame. `note` is "" for a mark without a note; None removes the mark."""
        self.frames.marks.pop(number, None)
        if note is not None:
            self.frames.marks[number] = note
        self.frames.repaint()
        self.show_frame()

    @work
    async def action_note(self) -> None:
        number = self.frame_number
        if number is None:
            return
        title = label("traffic.note.title", number=number)
        note = await self.ask(title, label("traffic.note.hint"), self.frames.marks.get(number, ""))
        if note is not None:
            self._set_note(number, printable(note.strip()) or None)

    @work
    async def action_save(self) -> None:
        packets = self.feed.progress.packets
        if not packets or self.feed.journal is None:
            app_of(self).show_message(label("traffic.nothing_to_save"), "warning")
            return
        source = self.feed.display_path
        proposed = source.with_name(f"{source.name.removesuffix('.gz').rpartition('.')[0]}-notes.pcapng")
        target = await self.ask(label("traffic.save.title"), label("traffic.save.hint"), str(proposed))
        if not target:
            return
        notes = frame_relations.notes_by_packet(self.frames.marks, self.frames.source.read_frame)
        app_of(self).show_message(label("traffic.saving", path=printable(target)))
        job = self.feed.make_save_job(str(Path(target).expanduser()), notes)
        problem, path = await asyncio.to_thread(self.feed.save, job), printable(job.target)
        if problem:
            app_of(self).show_message(label("traffic.unsaved", path=path, reason=problem), "error")
        else:
            app_of(self).show_message(label("traffic.saved", path=path))

    def commands(self) -> Iterator[tuple[str, str, str]]:
        if self.check_action("open", ()):
            for number, path in enumerate(app_of(self).settings.captures):
                name = label("traffic.open.recent", path=printable(path))
                yield name, label("traffic.open.tip"), f"open_recent({number})"

    def action_open_recent(self, number: int) -> None:
        self._open_capture(app_of(self).settings.captures[number])

    @work
    async def action_open(self) -> None:
        known = app_of(self).settings.captures
        folder = f"{Path(known[0]).parent}/" if known else ""
        path = await self.ask(label("traffic.open"), label("traffic.open.hint"), folder)
        if path:
            self._open_capture(str(Path(path).expanduser()))

    def _open_capture(self, path: str) -> None:
        # unlike `Path.is_file`, `os.path.isfile` raises no exception for a name that is too long
        if not os.path.isfile(path):
            app_of(self).show_message(label("traffic.open.none", path=printable(path)), "warning")
            return
        try:
            feed = TrafficFeed(ReadJob(path=path, ports=self.feed.job.ports))
        except TemporaryFolderError as error:
            app_of(self).show_message(printable(full_error_text(error)), "error")
        else:
            self.replace_feed(feed, Path(path).name)

    def action_stop(self) -> None:
        self.feed.stop_reading()


class SimulatorScreen(TrafficScreen):
    """Shows the traffic and the address of a simulator, whose process is `child`."""

    def __init__(self, feed: TrafficFeed, address: str, child: ChildProcess) -> None:
        super().__init__(feed, address)
        self._address = address
        self._child = child

    def on_mount(self) -> None:
        self._show_address("good", "●")
        app_of(self).show_message(label("simulator.listens", address=printable(self._address)))
        self._child.subscribe_end(partial(self.call_in_screen, self._show_end))

    def _show_address(self, ink: str, sign: str) -> None:
        app_of(self).status = ((f"{sign} {printable(self._address)} ", ink),)

    def _show_end(self, last_line: str) -> None:
        reason = label("simulator.ended", reason=printable(last_line) or label("proxy.killed"))
        self.feed.stop_reading()
        self.feed.report_source_problem(reason)
        self._show_address("bad", "○")
        app_of(self).show_message(reason, "error")
