"""Packet as b-CAP Tester has it: SendData, ReceiveData, Overwrite, Clear; and all that was before."""

from __future__ import annotations

from pathlib import Path

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button

from bcapscope.protocol.commands import call_name
from bcapscope.render.escape import printable
from bcapscope.traffic.question import Question
from bcapscope.tui.app import scope_of
from bcapscope.tui.desk.record import Record, Who
from bcapscope.tui.desk.saved import SavedError, save
from bcapscope.tui.ink import INK
from bcapscope.tui.tester.ask import NameDialog
from bcapscope.tui.tester.choice import Choice
from bcapscope.tui.tester.history import HistoryLines, HistoryPanel
from bcapscope.tui.tester.packetbox import PacketBox
from bcapscope.tui.tester.savedlist import SavedList
from bcapscope.tui.tester.tick import Tick
from bcapscope.tui.tester.watchlist import WatchList
from bcapscope.tui.widgets.inked import InkedText
from bcapscope.tui.words import say, told

VIEWS = ("sent", "received", "history", "watch", "saved")
"""Names of the views, in their order."""

_MOST_TRIES = 8


class PacketPane(Vertical):
    """What was sent and received last, and all that was before.

    Where there is room, both packets are always in sight, and the choice is between the others.
    """

    def __init__(self, requests: Path, *, id: str | None = None) -> None:
        """Take the folder of saved requests."""
        super().__init__(id=id)
        self._requests = requests

    def compose(self) -> ComposeResult:
        """Put the packets above the lists."""
        with Horizontal(classes="row", id="views"):
            yield Choice([(view, f"tester.view.{view}") for view in VIEWS], id="view")
            yield Tick(say("tester.overwrite"), True, id="overwrite")
            yield Button(say("tester.clear"), compact=True, id="clear")
        yield PacketBox("tester.senddata", id="sent")
        yield PacketBox("tester.receivedata", id="received")
        yield InkedText(id="tries")
        yield HistoryPanel(id="history")
        yield WatchList(id="watch")
        yield SavedList(self._requests, id="saved")

    def on_mount(self) -> None:
        """Begin with what was sent."""
        self._turn_to("sent")

    def take(self, record: Record) -> None:
        """Take a call that has ended: into the history, and its packets into sight if the user wanted it."""
        self.query_one(HistoryPanel).add(record)
        if record.who is Who.USER:
            self.show(record, self.query_one("#overwrite", Tick).value)

    def show(self, record: Record, overwrite: bool = True) -> None:
        """Show the packets of a call, and under them its tries."""
        text = next((each.value for each in record.arguments if isinstance(each.value, str)), None)
        question = Question(record.function_id, text)
        self.query_one("#sent", PacketBox).add(record.sent, None, overwrite, show_first=True)
        self.query_one("#received", PacketBox).add(record.received, question, overwrite, show_first=False)
        self._tries(record)

    @property
    def chosen(self) -> str:
        """The view that is shown."""
        return self.query_one("#view", Choice).chosen

    def turn_to(self, view: str) -> None:
        """Show one of the views."""
        self.query_one("#view", Choice).chosen = view
        self._turn_to(view)

    def _tries(self, record: Record) -> None:
        """Say what became of each try, where there is more to say than that the first was answered."""
        lines = []
        if record.retries or record.notices or record.late:
            attempts = record.attempts
            start = attempts[0].sent if attempts else 0
            lines = [
                f"{INK.dim}{number}{INK.reset} {printable(told(each.text(start)))}"
                for number, each in enumerate(attempts, 1)
            ]
            if len(lines) > _MOST_TRIES:
                lines[_MOST_TRIES:] = [f"{INK.dim}… {len(lines) - _MOST_TRIES}{INK.reset}"]
            if record.notices:
                lines.append(f"{INK.number}S_EXECUTING × {record.notices}{INK.reset}")
            if record.late:
                lines.append(f"{INK.problem}{say('tester.late', count=record.late)}{INK.reset}")
        tries = self.query_one("#tries", InkedText)
        tries.write("\n".join(lines))
        tries.set_class(not lines, "-empty")

    def _turn_to(self, view: str) -> None:
        for each in VIEWS:
            self.query_one(f"#{each}").set_class(each == view, "-on")
        self.set_class(view in ("sent", "received"), "-packets")

    @on(Choice.Chosen, "#view")
    def _chosen(self, message: Choice.Chosen) -> None:
        message.stop()
        self._turn_to(message.value)
        if message.value == "saved":
            self.query_one(SavedList).reload()

    @on(HistoryLines.Wanted)
    def _save(self, message: HistoryLines.Wanted) -> None:
        """Save a call as a file; all else that is wanted of a call is not ours."""
        if message.what != "save":
            return
        message.stop()
        record = message.record

        def take(name: str | None) -> None:
            if not name:
                return
            try:
                path = save(self._requests, name, record.function_id, record.arguments)
            except SavedError as error:
                scope_of(self).tell(str(error), "error")
                return
            scope_of(self).tell(say("tester.saved", path=printable(str(path))))
            self.query_one(SavedList).reload()

        first = call_name(record.function_id, record.arguments)
        self.app.push_screen(NameDialog(say("tester.save"), printable(first)), take)

    @on(HistoryPanel.Shown)
    def _shown(self, message: HistoryPanel.Shown) -> None:
        message.stop()
        self.show(message.record)

    @on(Button.Pressed, "#clear")
    def _clear(self, message: Button.Pressed) -> None:
        message.stop()
        self.query_one("#sent", PacketBox).clear()
        self.query_one("#received", PacketBox).clear()
        self.query_one("#tries", InkedText).set_class(True, "-empty")
