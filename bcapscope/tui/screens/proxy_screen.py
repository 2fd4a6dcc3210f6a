"""The proxy screen: clients, rules and held messages of a proxy, and the delay that the proxy adds."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar

import msgspec
from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType

from bcapscope.errors import BcapError
from bcapscope.faults.fault_notation import read_fault
from bcapscope.live.child_process import ChildProcess
from bcapscope.protocol.codec.frame import parse_datagram
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_client import ControlClient, ControlRefused
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import app_of
from bcapscope.tui.ink import INK
from bcapscope.tui.proxy_display import (
    ClientList,
    HeldList,
    ProxyLog,
    RuleList,
    edited_message,
    intercept_line,
    proposed_edit,
    summary_lines,
)
from bcapscope.tui.reader_language import full_error_text, label
from bcapscope.tui.screens.base_screen import ViewsScreen, view_keys
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from bcapscope.tui.widgets.bars import ViewBar
from bcapscope.tui.widgets.lines import ItemList, Lines
from bcapscope.tui.widgets.packet_view import FieldTree, PacketView
from bcapscope.tui.widgets.plain_containers import PlainVertical, Switcher
from bcapscope.tui.widgets.text_widgets import CheckedInput, InkedText


class ProxyState(msgspec.Struct, frozen=True):
    """All responses to one poll."""

    clients: list[control.ClientStatus]
    rules: list[control.FaultStatus]
    held: list[control.HeldStatus]
    figures: control.ProxyStats


POLL_INTERVAL = 0.5  # seconds between two queries of the proxy's state

_RULE_ACTIONS = frozenset({"switch", "remove"})
_HELD_ACTIONS = frozenset({"forward", "drop", "edit", "bytes"})


class ProxyScreen(ViewsScreen):
    NAME = "proxy"
    ABOUT = "proxy.about"
    AUTO_FOCUS = "#clients"
    VIEWS: ClassVar[Mapping[str, str]] = {
        view: f"proxy.{view}" for view in ("clients", "rules", "held", "messages")
    }
    BINDINGS: ClassVar[list[BindingType]] = [
        *view_keys(VIEWS, "proxy.view.tip"),
        Binding("space", "switch", "proxy.switch"),
        Binding("a", "add", "proxy.add"),
        Binding("d", "remove", "proxy.remove"),
        Binding("f", "forward", "proxy.forward"),
        Binding("e", "edit", "proxy.edit"),
        Binding("b", "bytes", "proxy.bytes"),
        Binding("x", "drop", "proxy.drop"),
        Binding("i", "intercept", "proxy.intercept"),
        Binding("escape", "back", "proxy.back", show=False),
    ]

    def __init__(
        self,
        address: str,
        route: str,
        feed: TrafficFeed | None = None,
        child: ChildProcess | None = None,
        note: str = "",
    ) -> None:
        """Control the proxy whose control socket has the address `address`.

        Args:
            route: Text with the proxy's listening address and the controller's address.
            feed: Traffic of the proxy that the traffic screen shows; None if there is no traffic screen.
            child: Process of the proxy; None if bcapscope did not start the proxy.
            note: Warning to show at the start; "" for no warning.
        """
        super().__init__()
        self.clients = ClientList("proxy.empty.clients", id="clients")
        self.rules = RuleList("proxy.empty.rules", id="rules")
        self.held = HeldList("proxy.empty.held", id="held")
        self._messages = ProxyLog("proxy.empty.messages", id="messages")
        self._change_line = CheckedInput("change", self._edited_bytes, label("proxy.edit.hint"))
        self._control_client = ControlClient(address)
        self._control_lock = threading.Lock()  # only one thread at a time may use the control client
        self.route = route
        self._feed = feed
        self._child = child
        self._note = note
        self._state: ProxyState | None = None
        self._problem = ""
        self._has_ended = False
        self._shown_message: int | None = None

    def content(self) -> ComposeResult:
        yield InkedText(id="summary")
        yield ViewBar(self.VIEWS, id="views")
        yield InkedText(id="head")
        with Switcher(initial="clients", id="lists"):
            yield from (self.clients, self.rules, self.held, self._messages)
        yield CheckedInput("fault", read_fault, label("proxy.add.hint"))
        with PlainVertical(id="message"):
            yield InkedText(id="intercepts")
            yield PacketView(id="packet")
            yield self._change_line

    def on_mount(self) -> None:
        if self._child is not None:
            self._child.subscribe_output(partial(self.call_in_screen, self.add_output))
            self._child.subscribe_end(partial(self.call_in_screen, self.show_end))
        app_of(self).closers.callback(self._control_client.close)
        if self._note:
            app_of(self).show_message(self._note, "warning")
        self.set_interval(POLL_INTERVAL, self._poll)
        self.action_view("clients")
        self._poll()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        if action in _RULE_ACTIONS:
            return self.view == "rules" and self.rules.current_item is not None
        if action in _HELD_ACTIONS:
            return self.view == "held" and self.held.current_item is not None
        return True

    # queries and orders

    @work(thread=True, group="poll", exclusive=True)
    def _poll(self) -> None:
        if not self._has_ended:
            self._query_state()

    def _query_state(self) -> None:
        try:
            self.call_in_screen(self._update_state, self.read_state())
        except BcapError as error:
            self.call_in_screen(self._show_lost_proxy, full_error_text(error))

    def read_state(self) -> ProxyState:
        """Return the proxy's state; raises `ControlError` if the proxy does not respond."""
        with self._control_lock:
            request = self._control_client.request
            return ProxyState(
                request(control.ListClients(), control.ClientsResponse).clients,
                request(control.ListFaults(), control.FaultsResponse).rules,
                request(control.ListHeld(), control.HeldResponse).held,
                request(control.GetStats(), control.ProxyStats),
            )

    @work(thread=True, group="order")
    def _send_order(self, order: control.ControlRequest, done: Callable[[], None] = lambda: None) -> None:
        try:
            with self._control_lock:
                self._control_client.request(order, control.DoneResponse)
            self.call_in_screen(done)
        except ControlRefused as error:
            text = label("proxy.refusal", reason=printable(full_error_text(error)))
            self.call_in_screen(app_of(self).show_message, text, "error")
        except BcapError as error:
            self.call_in_screen(self._show_lost_proxy, full_error_text(error))
        self._query_state()

    def _update_state(self, state: ProxyState) -> None:
        if self._has_ended:
            return
        if self._problem:
            self._problem = ""
            self._report_source_problem("")
        self._state = state
        self.clients.show_items(state.clients)
        self.rules.show_items(state.rules)
        self.held.show_items(state.held)
        self.show_state()

    def _show_lost_proxy(self, problem: str) -> None:
        if self._has_ended:
            return
        if not self._problem:
            text = label("proxy.gone", reason=printable(problem))
            app_of(self).show_message(text, "error")
            self._report_source_problem(text)
        self._problem = problem
        self.show_state()

    def _report_source_problem(self, reason: str) -> None:
        if self._feed is not None:
            self._feed.report_source_problem(reason)

    def add_output(self, text: str) -> None:
        self._messages.add_message(text)
        self.show_state()

    def show_end(self, last_line: str) -> None:
        """Show that the proxy has ended. `last_line` is the proxy's last output; "" for a killed proxy."""
        self._has_ended = True
        self._problem = label("proxy.ended", reason=printable(last_line) or label("proxy.killed"))
        app_of(self).show_message(self._problem, "error")
        self._report_source_problem(self._problem)
        if self._feed is not None:
            self._feed.stop_reading()
        self.show_state()

    # display

    def show_state(self) -> None:
        key, ink = ("proxy.not_here", "bad") if self._problem else ("proxy.here", "good")
        held = 0 if self._has_ended else len(self.held.items)
        waiting = f" · {label('proxy.waiting', count=held)}" if held else ""
        app_of(self).status = ((f"{label(key, way=printable(self.route))}{waiting} ", ink),)
        lines = []
        if self._state is not None:
            lines = summary_lines(self._state.figures)
            self.query_one("#intercepts", InkedText).show_text(intercept_line(self._state.figures))
        if self._problem:
            lines.append(f"{INK.problem} {printable(self._problem)}{INK.reset}")
        self.query_one("#summary", InkedText).show_text("\n".join(lines))
        lists: list[ItemList[Any]] = [self.clients, self.rules, self.held, self._messages]
        counts = {str(each.id): str(len(each.items) or "") for each in lists}
        self.query_one(ViewBar).show_counts(self.view, counts, ())
        self._show_message()
        self.refresh_bindings()

    def _show_message(self) -> None:
        held = self.held.current_item
        number = None if held is None else held.number
        if number != self._shown_message:
            self._shown_message = number
            self._change_line.set_text("")
            if held is None:
                self.query_one(PacketView).show_packet(None)
            else:
                self._show_bytes(held, held.data)

    def _show_bytes(self, held: control.HeldStatus, data: bytes) -> None:
        """Show the first frame of a held message. `data` is the message before or after the user's edit."""
        first = next(iter(parse_datagram(data)), None)
        frame = Observation(held.number, 0, 0, held.flow, first, 0) if first is not None else None
        self.query_one(PacketView).show_packet(frame, held.call_kind)

    @on(Lines.Moved)
    def _cursor_moved(self, message: Lines.Moved) -> None:
        if message.lines is self.held:
            self._show_message()

    def show_view(self) -> None:
        self.query_one("#fault-line").display = self.view == "rules"
        self.query_one("#message").display = self.view == "held"
        self.show_header()

    # rules

    def action_switch(self) -> None:
        rule = self.rules.current_item
        if rule is not None:
            self._send_order(control.DisableFault(rule.name) if rule.on else control.EnableFault(rule.name))

    def action_remove(self) -> None:
        rule = self.rules.current_item
        if rule is not None:
            self._send_order(control.RemoveFault(rule.name))

    def action_add(self) -> None:
        self.action_view("rules")
        self.set_focus(self.query_one("#fault"))

    @on(CheckedInput.Entered, "#fault-line")
    def _fault_entered(self, message: CheckedInput.Entered) -> None:
        if message.text:
            self._send_order(control.AddFault(message.text), self._fault_added)

    def _fault_added(self) -> None:
        self.query_one("#fault-line", CheckedInput).set_text("")
        self.set_focus(self.shown_list)

    # held messages

    @work
    async def action_intercept(self) -> None:
        self.action_view("held")
        known = self._state.figures.intercept if self._state is not None else None
        answer = await self.ask(label("proxy.intercept.title"), label("proxy.intercept.hint"), known or "")
        if answer is not None:
            self._send_order(control.SetIntercept(answer.strip() or None))

    def action_forward(self) -> None:
        self._send_decision(control.ForwardHeld, "proxy.sent")

    def action_drop(self) -> None:
        self._send_decision(control.DropHeld, "proxy.dropped")

    def _send_decision(self, decide: Callable[[int], control.ControlRequest], word: str) -> None:
        held = self.held.current_item
        if held is not None:
            text = label(word, number=held.number)
            self._send_order(decide(held.number), partial(self._decision_done, text))

    def _decision_done(self, text: str) -> None:
        self._messages.add_message(text)
        self.set_focus(self.shown_list)

    def action_edit(self) -> None:
        """Propose an edit of the argument under the cursor of the field tree."""
        held = self.held.current_item
        if held is not None:
            self._propose_change(proposed_edit(held.data, self.query_one(FieldTree).offset_in_frame))

    def action_bytes(self) -> None:
        held = self.held.current_item
        if held is not None:
            self._propose_change(held.data.hex(" ").upper())

    def _propose_change(self, text: str) -> None:
        self._change_line.set_text(text)  # the proposal changes nothing yet
        self.set_focus(self._change_line.field)

    def _edited_bytes(self, text: str) -> bytes | None:
        """Return the held message after the edit; None if the proxy no longer holds the message."""
        held = self.held.current_item
        return None if held is None else edited_message(held.data, held.flow, text)

    @on(CheckedInput.Typed, "#change-line")
    def _change_typed(self, message: CheckedInput.Typed) -> None:
        held, edited = self.held.current_item, message.parsed
        if held is not None:
            self._show_bytes(held, edited if isinstance(edited, bytes) else held.data)

    @on(CheckedInput.Entered, "#change-line")
    def _change_entered(self, message: CheckedInput.Entered) -> None:
        if isinstance(message.parsed, bytes):
            self._send_decision(partial(control.EditHeld, hex=message.parsed.hex()), "proxy.edited")
