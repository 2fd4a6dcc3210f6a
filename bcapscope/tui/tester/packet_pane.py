"""The packet pane: SendData and ReceiveData as in b-CAP Tester, history, watch list and saved requests."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Button

from bcapscope.live.controller.history_record import HistoryRecord, Initiator
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.render.escape import printable
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import app_of
from bcapscope.tui.controller_access.saved_requests import SavedRequestError, save_request
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import full_error_text, label, reader_words
from bcapscope.tui.screens.base_screen import Prompt
from bcapscope.tui.tester.call_lists import HistoryLines, HistoryPanel, SavedList, WatchList
from bcapscope.tui.tester.form_widgets import ChoiceRow, FormButton, TickBox
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.packet_view import PacketView
from bcapscope.tui.widgets.text_widgets import InkedText

MAX_PACKETS = 2000
MAX_BYTES = 16 << 20
"""Maximum size in bytes of the packets in a `PacketBox`, which always keeps the newest packet."""


class PacketBox(Vertical):
    """Shows one packet at a time. The keys ``[`` and ``]`` show the previous and the next packet."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left_square_bracket", "step(-1)", "tester.packet.before", key_display="["),
        Binding("right_square_bracket", "step(1)", "tester.packet.after", key_display="]"),
    ]

    def __init__(self, name: str, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._title = name
        self._packets: list[tuple[Observation, CallKind | None]] = []
        self._index = 0

    def compose(self) -> ComposeResult:
        yield InkedText(classes="title")
        yield PacketView()

    def on_mount(self) -> None:
        self._show_packet()

    @property
    def shown_packet(self) -> Observation | None:
        return self._packets[self._index][0] if self._packets else None

    def clear_packets(self) -> None:
        self._packets = []
        self._index = 0
        self._show_packet()

    def add_packets(
        self, packets: tuple[Observation, ...], call_kind: CallKind | None, overwrite: bool, show_first: bool
    ) -> None:
        """Add packets, and show the first (`show_first`) or the last of them."""
        if overwrite:
            self._packets = []
        self._packets += [(seen, call_kind) for seen in packets]
        del self._packets[:-MAX_PACKETS]
        while sum(len(seen.item.raw) for seen, _ in self._packets) > MAX_BYTES and len(self._packets) > 1:
            del self._packets[: len(self._packets) // 10 or 1]
        self._index = max(0, len(self._packets) - (len(packets) if show_first else 1))
        self._show_packet()

    def action_step(self, by: int) -> None:
        if 0 <= self._index + by < len(self._packets):
            self._index += by
            self._show_packet()

    def _show_packet(self) -> None:
        text = f"{INK.name}{label(self._title)}{INK.reset}"
        seen, call_kind = self._packets[self._index] if self._packets else (None, None)
        self.query_one(PacketView).show_packet(seen, call_kind)
        if seen is not None:
            item = seen.item
            text += f"  {INK.dim}{label('tester.size', count=len(item.raw))}"
            if isinstance(item, Frame):
                text += f"  serial {item.serial}  reserved {item.reserved}"
            if len(self._packets) > 1:
                text += f"  [{self._index + 1}/{len(self._packets)}]"
            text += INK.reset
        self.query_one(".title", InkedText).show_text(text)


VIEWS = ("sent", "received", "history", "watch", "saved")
_MAX_ATTEMPT_LINES = 8


class PacketPane(Vertical):
    """Shows the packets of the latest call, and the lists of calls, variables and requests.

    On a wide screen, SendData and ReceiveData stay visible, and the user switches only between the lists.
    """

    def __init__(self, requests: Path, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._requests = requests

    def compose(self) -> ComposeResult:
        with Horizontal(classes="row", id="views"):
            yield ChoiceRow([(view, f"tester.view.{view}") for view in VIEWS], id="view")
            yield TickBox(label("tester.overwrite"), True, id="overwrite")
            yield FormButton("tester.clear", id="clear")
        yield PacketBox("tester.senddata", id="sent")
        yield PacketBox("tester.receivedata", id="received")
        yield InkedText(id="tries")
        yield HistoryPanel(id="history")
        yield WatchList(id="watch")
        yield SavedList(self._requests, id="saved")

    def on_mount(self) -> None:
        self._switch_view("sent")

    def add_record(self, record: HistoryRecord) -> None:
        """Add a completed call to the history. If the user made the call, show the call's packets."""
        self.query_one(HistoryPanel).add_record(record)
        if record.initiator is Initiator.USER:
            self.show_record(record, self.query_one("#overwrite", TickBox).value)

    def show_record(self, record: HistoryRecord, overwrite: bool = True) -> None:
        text = next((each.value for each in record.arguments if isinstance(each.value, str)), None)
        sent, received = (self.query_one(name, PacketBox) for name in ("#sent", "#received"))
        sent.add_packets(record.sent_packets, None, overwrite, show_first=True)
        call_kind = CallKind(record.function_id, text)
        received.add_packets(record.received_packets, call_kind, overwrite, show_first=False)
        self._show_attempts(record)

    def show_view(self, view: str) -> None:
        self.query_one("#view", ChoiceRow).chosen = view
        self._switch_view(view)

    def _show_attempts(self, record: HistoryRecord) -> None:
        lines = []
        if record.retries or record.notices or record.late_replies:
            attempts = record.attempts
            start = attempts[0].sent if attempts else 0
            lines = [
                f"{INK.dim}{number}{INK.reset} {printable(reader_words().text(each.describe(start)))}"
                for number, each in enumerate(attempts, 1)
            ]
            if len(lines) > _MAX_ATTEMPT_LINES:
                lines[_MAX_ATTEMPT_LINES:] = [f"{INK.dim}… {len(lines) - _MAX_ATTEMPT_LINES}{INK.reset}"]
            if record.notices:
                lines.append(f"{INK.number}S_EXECUTING × {record.notices}{INK.reset}")
            if record.late_replies:
                lines.append(f"{INK.problem}{label('tester.late', count=record.late_replies)}{INK.reset}")
        tries = self.query_one("#tries", InkedText)
        tries.show_text("\n".join(lines))
        tries.set_class(not lines, "-empty")

    def _switch_view(self, view: str) -> None:
        for each in VIEWS:
            self.query_one(f"#{each}").set_class(each == view, "-on")
        self.set_class(view in ("sent", "received"), "-packets")

    @on(ChoiceRow.Chosen, "#view")
    def _view_chosen(self, message: ChoiceRow.Chosen) -> None:
        self._switch_view(message.value)
        if message.value == "saved":
            self.query_one(SavedList).action_reload()

    @on(HistoryLines.ActionWanted)
    def _save_record(self, message: HistoryLines.ActionWanted) -> None:
        if message.what != "save":  # the Tester's screen handles the other actions
            return
        message.stop()
        record = message.record

        def take(name: str | None) -> None:
            if not name or not name.strip():
                return
            try:
                path = save_request(self._requests, name, record.function_id, record.arguments)
            except SavedRequestError as error:
                app_of(self).show_message(full_error_text(error), "error")
                return
            app_of(self).show_message(label("tester.saved", path=printable(str(path))))
            self.query_one(SavedList).action_reload()

        first = call_name(record.function_id, record.arguments)
        self.app.push_screen(Prompt(label("tester.save"), "", printable(first)), take)

    @on(Lines.Moved)
    def _show_selected_record(self, message: Lines.Moved) -> None:
        lines = message.lines
        if isinstance(lines, HistoryLines) and lines.current_item is not None and lines.has_focus:
            self.show_record(lines.current_item)

    @on(Button.Pressed, "#clear")
    def _clear_packets(self) -> None:
        self.query_one("#sent", PacketBox).clear_packets()
        self.query_one("#received", PacketBox).clear_packets()
        self.query_one("#tries", InkedText).set_class(True, "-empty")
