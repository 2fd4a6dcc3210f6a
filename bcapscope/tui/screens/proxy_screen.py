"""The proxy screen: shows clients, rules, held messages and delays; switches rules, edits held messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import ClassVar

from rich.text import Text
from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.events import Resize
from textual.widgets import Static

from bcapscope.errors import BcapError
from bcapscope.faults.fault_notation import read_fault
from bcapscope.live.child_process import ChildProcess
from bcapscope.protocol.codec.frame import parse_datagram
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_client import ControlRefused
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import app_of
from bcapscope.tui.ink import INK
from bcapscope.tui.proxy_panel.message_editing import edited_message, proposed_edit
from bcapscope.tui.proxy_panel.proxy_events import OrderDone, ProxyOutput, ProxyStateRead
from bcapscope.tui.proxy_panel.proxy_lists import ClientList, HeldList, ProxyLog, RuleList
from bcapscope.tui.proxy_panel.proxy_summary import intercept_line, summary_lines
from bcapscope.tui.proxy_panel.shared_control_client import ProxyState, SharedControlClient
from bcapscope.tui.reader_language import full_error_text, label
from bcapscope.tui.screens.prompt import Prompt
from bcapscope.tui.screens.views_screen import ViewsScreen, view_keys
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from bcapscope.tui.widgets.checked_input import CheckedInput
from bcapscope.tui.widgets.field_tree import FieldTree
from bcapscope.tui.widgets.inked_text import InkedText
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.packet_view import PacketView
from bcapscope.tui.widgets.plain_containers import PlainVertical, Switcher
from bcapscope.tui.widgets.view_bar import ViewBar

POLL_INTERVAL = 0.5
"""Time in seconds between two queries of the proxy's state."""

_RULE_ACTIONS = frozenset({"switch", "remove"})
_HELD_ACTIONS = frozenset({"forward", "drop", "edit", "bytes"})


class ProxyScreen(ViewsScreen):
    """Shows the state of a proxy, and sends orders to the proxy."""

    NAME = "proxy"
    ABOUT = "proxy.about"
    AUTO_FOCUS = "#clients"
    VIEWS: ClassVar[Mapping[str, str]] = {
        "clients": "proxy.clients",
        "rules": "proxy.rules",
        "held": "proxy.held",
        "messages": "proxy.messages",
    }
    BINDINGS: ClassVar[list[BindingType]] = [
        *view_keys(VIEWS, "proxy.view.tip"),
        Binding("space", "switch", "proxy.switch", id="proxy.switch", tooltip="proxy.switch.tip"),
        Binding("a", "add", "proxy.add", id="proxy.add", tooltip="proxy.add.tip"),
        Binding("d", "remove", "proxy.remove", id="proxy.remove", tooltip="proxy.remove.tip"),
        Binding("f", "forward", "proxy.forward", id="proxy.forward", tooltip="proxy.forward.tip"),
        Binding("e", "edit", "proxy.edit", id="proxy.edit", tooltip="proxy.edit.tip"),
        Binding("b", "bytes", "proxy.bytes", id="proxy.bytes", tooltip="proxy.bytes.tip"),
        Binding("x", "drop", "proxy.drop", id="proxy.drop", tooltip="proxy.drop.tip"),
        Binding("i", "intercept", "proxy.intercept", id="proxy.intercept", tooltip="proxy.intercept.tip"),
        Binding("escape", "back", "proxy.back", id="proxy.back", show=False, tooltip="proxy.back.tip"),
    ]

    def __init__(
        self,
        address: str,
        route: str,
        feed: TrafficFeed | None = None,
        child: ChildProcess | None = None,
        note: str = "",
    ) -> None:
        """Connect the screen to a proxy.

        Args:
            address: Address of the proxy's control socket.
            route: Text with the proxy's listening address and the controller's address.
            feed: Traffic on the traffic screen, which is notified when the proxy stops; None without traffic
                screen.
            child: Process of the proxy, if the screen started the proxy; None otherwise.
            note: Warning that the screen shows at the start; "" for none.
        """
        super().__init__()
        self._control_client = SharedControlClient(address)
        self.route = route
        self._feed = feed
        self._child = child
        self._note = note
        self._state: ProxyState | None = None
        self._problem = ""
        self._has_ended = False
        self._summary_lines: list[str] = []
        self._shown_message: int | None = None

    def content(self) -> ComposeResult:
        yield InkedText(id="summary")
        yield self.make_view_bar()
        yield Static(id="head")
        with Switcher(initial="clients", id="lists"):
            yield ClientList(id="clients")
            yield RuleList(id="rules")
            yield HeldList(id="held")
            yield ProxyLog(id="messages")
        yield CheckedInput("fault", read_fault, label("proxy.add.hint"))
        with PlainVertical(id="message"):
            yield InkedText(id="intercepts")
            yield PacketView(id="packet")
            yield CheckedInput("change", self._edited_bytes, label("proxy.edit.hint"))

    def on_mount(self) -> None:
        """Start to query the proxy."""
        if self._child is not None:
            self._child.subscribe_output(lambda text: self._post_output(text, False))
            self._child.subscribe_end(lambda text: self._post_output(text, True))
        app_of(self).add_closer(self._close)
        if self._note:
            app_of(self).show_message(self._note, "warning")
        self.set_interval(POLL_INTERVAL, self._poll)
        self.action_view("clients")
        self._poll()

    def _post_output(self, text: str, is_end: bool) -> None:
        """Forward the proxy's output from a reader thread to the screen."""
        self.post_message(ProxyOutput(text, is_end))

    async def _close(self) -> None:
        self._control_client.close()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer actions on a rule or held message only if the list has one."""
        if action in _RULE_ACTIONS:
            return self.view == "rules" and self.rules.current_item is not None
        if action in _HELD_ACTIONS:
            return self.view == "held" and self.held.current_item is not None
        return True

    # queries and orders

    @work(thread=True, group="poll", exclusive=True)
    def _poll(self) -> None:
        if not self._has_ended:
            self.post_message(self._read_state())

    def _read_state(self) -> ProxyStateRead:
        """Query the proxy's state in a thread, because the query blocks."""
        try:
            return ProxyStateRead(self._control_client.read_state())
        except BcapError as error:
            return ProxyStateRead(None, full_error_text(error))

    @work(thread=True, group="order")
    def _send_order(self, order: control.ControlRequest, done: Callable[[], None] = lambda: None) -> None:
        """Send an order to the proxy, and call `done` after the proxy has carried out the order."""
        try:
            self._control_client.send_order(order)
            self.post_message(OrderDone(done))
        except ControlRefused as error:
            text = label("proxy.refusal", reason=printable(full_error_text(error)))
            self.post_message(OrderDone(partial(app_of(self).show_message, text, "error")))
        except BcapError as error:
            self.post_message(ProxyStateRead(None, full_error_text(error)))
        self.post_message(self._read_state())

    def on_order_done(self, message: OrderDone) -> None:
        message.stop()
        message.callback()

    def on_proxy_state_read(self, message: ProxyStateRead) -> None:
        message.stop()
        if self._has_ended:
            return
        if message.state is None:
            if not self._problem:
                text = label("proxy.gone", reason=printable(message.problem))
                app_of(self).show_message(text, "error")
                self._report_source_problem(text)
            self._problem = message.problem
        else:
            if self._problem:
                self._report_source_problem("")
            self._problem = ""
            self._state = message.state
            self.clients.show(message.state.clients)
            self.rules.show(message.state.rules)
            self.held.show(message.state.held)
        self.show_state()

    def _report_source_problem(self, reason: str) -> None:
        """Tell the traffic screen that the proxy may send no further traffic."""
        if self._feed is not None:
            self._feed.report_source_problem(reason)

    def on_proxy_output(self, message: ProxyOutput) -> None:
        message.stop()
        if message.is_end:
            reason = printable(message.text) or label("proxy.killed")
            self._has_ended = True
            self._problem = label("proxy.ended", reason=reason)
            app_of(self).show_message(self._problem, "error")
            self._report_source_problem(self._problem)
            if self._feed is not None:
                self._feed.stop_reading()
        else:
            self.query_one(ProxyLog).add_message(message.text)
        self.show_state()

    # display

    @property
    def clients(self) -> ClientList:
        return self.query_one(ClientList)

    @property
    def rules(self) -> RuleList:
        return self.query_one(RuleList)

    @property
    def held(self) -> HeldList:
        return self.query_one(HeldList)

    def show_state(self) -> None:
        """Show the proxy's state, and the held message under the cursor."""
        app, standing = app_of(self), self._state
        key, ink = ("proxy.not_here", "bad") if self._problem else ("proxy.here", "good")
        waiting = (
            ""
            if standing is None or not standing.held or self._has_ended
            else f" · {label('proxy.waiting', count=len(standing.held))}"
        )
        app.status = ((f"{label(key, way=printable(self.route))}{waiting} ", ink),)
        counts = {"messages": f"{self.query_one(ProxyLog).message_count or ''}"}
        lines = [] if standing is None else summary_lines(standing.figures)
        if self._problem:
            lines.append(f"{INK.problem} {printable(self._problem)}{INK.reset}")
        if standing is not None:
            counts |= {
                "clients": f"{len(standing.clients) or ''}",
                "rules": f"{len(standing.rules) or ''}",
                "held": f"{len(standing.held) or ''}",
            }
            self.query_one("#intercepts", InkedText).show_text(intercept_line(standing.figures))
        if lines != self._summary_lines:  # compared first, because a new height needs a new layout
            self._summary_lines = lines
            self.query_one("#summary", InkedText).show_text("\n".join(lines))
        self.query_one(ViewBar).show_counts(self.view, counts, ())
        self._show_message()
        self.refresh_bindings()

    def _show_message(self) -> None:
        """Show the held message under the cursor, unless the screen already shows it."""
        held = self.held.current_item
        number = None if held is None else held.number
        if number != self._shown_message:
            self._shown_message = number
            self._change_line.set_text("")
            self._show_bytes(held, b"" if held is None else held.data)

    def _show_bytes(self, held: control.HeldStatus | None, data: bytes) -> None:
        """Show the first frame of a held message, in its present or edited form."""
        items = parse_datagram(data) if held is not None else ()
        if held is None or not items:
            self.query_one(PacketView).show_packet(None)
            return
        seen = Observation(held.number, 0, 0, held.flow, items[0], 0)
        self.query_one(PacketView).show_packet(seen, held.call_kind)

    def on_resize(self, event: Resize) -> None:
        """Adapt the height of the message view to the height of the screen."""
        self.query_one("#message").styles.height = max(9, min(30, event.size.height // 2))

    @on(Lines.Moved)
    def _cursor_moved(self, message: Lines.Moved) -> None:
        if message.lines is self.held:
            self._show_message()

    def show_view(self) -> None:
        """Show the column header, and the widgets that belong to the visible list."""
        self.query_one("#fault-line").display = self.view == "rules"
        self.query_one("#message").display = self.view == "held"
        shown = self.shown_list
        head = shown.header() if isinstance(shown, ClientList | RuleList | HeldList) else ""
        self.query_one("#head", Static).update(Text(head, no_wrap=True, overflow="crop"))

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
        """Ask which messages to hold."""
        self.action_view("held")
        known = self._state.figures.intercept if self._state is not None else None
        prompt = Prompt(label("proxy.intercept.title"), label("proxy.intercept.hint"), known or "")
        answer = await self.app.push_screen_wait(prompt)
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
        self.query_one(ProxyLog).add_message(text)
        self.set_focus(self.shown_list)

    def action_edit(self) -> None:
        """Propose an edit of the held message's argument under the tree's cursor."""
        held = self.held.current_item
        if held is not None:
            self._propose_change(proposed_edit(held.data, self.query_one(FieldTree).offset_in_frame))

    def action_bytes(self) -> None:
        """Propose an edit of all bytes of the held message, in hex."""
        held = self.held.current_item
        if held is not None:
            self._propose_change(held.data.hex(" ").upper())

    @property
    def _change_line(self) -> CheckedInput:
        return self.query_one("#change-line", CheckedInput)

    def _propose_change(self, text: str) -> None:
        self._change_line.set_text(text)  # the proposal changes nothing yet
        self.set_focus(self._change_line.field)

    def _edited_bytes(self, text: str) -> bytes | None:
        """Return the held message after the edit; None if the proxy no longer holds the message."""
        held = self.held.current_item
        return None if held is None else edited_message(held.data, held.flow, text)

    @on(CheckedInput.Typed, "#change-line")
    def _change_typed(self, message: CheckedInput.Typed) -> None:
        """Show the message as edited."""
        held, made = self.held.current_item, message.parsed
        if held is not None:
            self._show_bytes(held, made if isinstance(made, bytes) else held.data)

    @on(CheckedInput.Entered, "#change-line")
    def _change_entered(self, message: CheckedInput.Entered) -> None:
        if isinstance(message.parsed, bytes):
            self._send_decision(partial(control.EditHeld, hex=message.parsed.hex()), "proxy.edited")
