"""Proxy: who is there, faults on and off, messages held and changed, how long it holds what passes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import ClassVar, TypeVar

import msgspec
from rich.text import Text
from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.events import Resize
from textual.message import Message
from textual.widgets import ContentSwitcher, Input, Static

from bcapscope.errors import BcapError
from bcapscope.faults.notation import read_fault
from bcapscope.protocol.frame import parse_datagram
from bcapscope.proxy.control_client import Answer, ControlClient, ControlRefused
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import scope_of
from bcapscope.tui.child import Child
from bcapscope.tui.ink import INK, inked
from bcapscope.tui.proxy.editing import edited, proposal
from bcapscope.tui.proxy.lists import ClientList, HeldList, RuleList, Told
from bcapscope.tui.proxy.standing import Client, Held, Rule, Standing, figures_of, list_of
from bcapscope.tui.proxy.summary import intercepts, summary
from bcapscope.tui.screens.place import Place
from bcapscope.tui.screens.prompt import Prompt
from bcapscope.tui.widgets.fieldtree import FieldTree
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.packet import PacketView
from bcapscope.tui.widgets.viewbar import ViewBar
from bcapscope.tui.words import say

VIEWS = ("clients", "rules", "held", "told")
EVERY = 0.5
"""Seconds between two questions how the proxy stands."""

T = TypeVar("T")

_OF_RULES = frozenset({"switch", "remove"})
_OF_HELD = frozenset({"forward", "drop", "edit", "bytes"})


class Stands(Message):
    """The proxy has told how it stands, or why it does not answer."""

    def __init__(self, standing: Standing | None, trouble: str = "") -> None:
        super().__init__()
        self.standing, self.trouble = standing, trouble


class Said(Message):
    """The proxy said something, or ended; then `text` are its last words."""

    def __init__(self, text: str, is_end: bool) -> None:
        super().__init__()
        self.text, self.is_end = text, is_end


class ProxyScreen(Place):
    """Shows a proxy and tells it what to do."""

    NAME = "proxy"
    ABOUT = "proxy.about"
    AUTO_FOCUS = "#clients"
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(f"{number}", f"view('{view}')", f"proxy.{view}", show=False, tooltip="proxy.view.tip")
            for number, view in enumerate(VIEWS, 1)
        ),
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

    def __init__(self, address: str, way: str, child: Child | None = None, note: str = "") -> None:
        """Take the proxy.

        Args:
            address: of its control socket.
            way: where it listens and where that leads, for people.
            child: the proxy itself, where the screen has started it.
            note: what is to be said at first; "" for nothing.
        """
        super().__init__()
        self._client = ControlClient(address)
        self._lock = threading.Lock()
        self.way = way
        self._child = child
        self._note = note
        self._view = "clients"
        self._standing: Standing | None = None
        self._trouble = ""
        self._is_over = False
        self._lines: list[str] = []
        self._shown: int | None = None

    def content(self) -> ComposeResult:
        """Yield what is true of all of it, then the lists."""
        yield Static(id="summary")
        yield ViewBar([(view, f"proxy.{view}") for view in VIEWS], id="views")
        yield Static(id="head")
        with ContentSwitcher(initial="clients", id="lists"):
            yield ClientList(id="clients")
            yield RuleList(id="rules")
            yield HeldList(id="held")
            yield Told(id="told")
        with Vertical(id="adding"):
            yield Input(placeholder=say("proxy.add.hint"), id="fault")
            yield Static(id="fault-error")
        with Vertical(id="message"):
            yield Static(id="intercepts")
            yield PacketView(id="packet")
            yield Input(placeholder=say("proxy.edit.hint"), id="change", select_on_focus=False)
            yield Static(id="change-error")

    def on_mount(self) -> None:
        """Begin to ask."""
        if self._child is not None:
            self._child.listen(lambda text: self._said(text, False))
            self._child.at_end(lambda text: self._said(text, True))
        scope_of(self).at_close(self._close)
        if self._note:
            scope_of(self).tell(self._note, "warning")
        self.set_interval(EVERY, self._poll)
        self.action_view("clients")
        self._poll()

    def _said(self, text: str, is_end: bool) -> None:
        """Take what the proxy says in another thread."""
        self.post_message(Said(text, is_end))

    async def _close(self) -> None:
        self._client.close()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer what has to do with a rule or a message only where one is."""
        if action in _OF_RULES:
            return self._view == "rules" and self.rules.current is not None
        if action in _OF_HELD:
            return self._view == "held" and self.held.current is not None
        return True

    # asking and telling

    @work(thread=True, group="poll", exclusive=True)
    def _poll(self) -> None:
        """Ask how the proxy stands."""
        if not self._is_over:
            self.post_message(self._ask_all())

    def _ask_all(self) -> Stands:
        """Ask; in a thread, as it may wait."""
        with self._lock:
            try:
                ask = self._client.ask
                return Stands(
                    Standing(
                        list_of(ask({"do": "clients"}), "clients", Client),
                        list_of(ask({"do": "rules"}), "rules", Rule),
                        list_of(ask({"do": "held"}), "held", Held),
                        figures_of(ask({"do": "stats"})),
                    )
                )
            except msgspec.ValidationError:
                return Stands(None, say("proxy.strange"))
            except BcapError as error:
                return Stands(None, str(error))

    @work(thread=True, group="order")
    def _order(self, question: Mapping[str, object], done: Callable[[Answer], None]) -> None:
        """Have the proxy do something; `done` is called when it has."""
        app = scope_of(self)
        try:
            with self._lock:
                answer = self._client.ask(question)
        except ControlRefused as error:
            text = say("proxy.refusal", reason=printable(str(error)))
            app.call_from_thread(app.tell, text, "error")
        except BcapError as error:
            self.post_message(Stands(None, str(error)))
        else:
            app.call_from_thread(done, answer)
        self.post_message(self._ask_all())

    def on_stands(self, message: Stands) -> None:
        """Show how the proxy stands."""
        message.stop()
        if self._is_over:
            return
        if message.standing is None:
            if not self._trouble:
                text = say("proxy.gone", reason=printable(message.trouble))
                scope_of(self).tell(text, "error")
            self._trouble = message.trouble
        else:
            self._trouble = ""
            self._standing = message.standing
            self.clients.show(message.standing.clients)
            self.rules.show(message.standing.rules)
            self.held.show(message.standing.held)
        self._show_state()

    def on_said(self, message: Said) -> None:
        """Show what the proxy said."""
        message.stop()
        if message.is_end:
            reason = printable(message.text) or say("proxy.no_words")
            self._is_over = True
            self._trouble = say("proxy.ended", reason=reason)
            scope_of(self).tell(self._trouble, "error")
        else:
            self.query_one(Told).add(message.text)
        self._show_state()

    # what is shown

    @property
    def clients(self) -> ClientList:
        """The list of clients."""
        return self.query_one(ClientList)

    @property
    def rules(self) -> RuleList:
        """The list of faults."""
        return self.query_one(RuleList)

    @property
    def held(self) -> HeldList:
        """The list of messages that wait."""
        return self.query_one(HeldList)

    @property
    def _list(self) -> Lines:
        found = self.query_one(f"#{self._view}")
        assert isinstance(found, Lines)
        return found

    def _show_state(self) -> None:
        app, standing = scope_of(self), self._standing
        key, ink = ("proxy.not_here", "bad") if self._trouble else ("proxy.here", "good")
        waiting = (
            ""
            if standing is None or not standing.held
            else f" · {say('proxy.waiting', count=len(standing.held))}"
        )
        app.status = Text(f"{say(key, way=printable(self.way))}{waiting} ", style=app.inks[ink])
        counts = {"told": f"{self.query_one(Told).lines or ''}"}
        lines = [] if standing is None else summary(standing.figures)
        if self._trouble:
            lines.append(f"{INK.problem} {printable(self._trouble)}{INK.reset}")
        if standing is not None:
            counts |= {
                "clients": f"{len(standing.clients) or ''}",
                "rules": f"{len(standing.rules) or ''}",
                "held": f"{len(standing.held) or ''}",
            }
            self.query_one("#intercepts", Static).update(inked(intercepts(standing.figures), app.inks))
        if lines != self._lines:  # its height may be another, which is to lay out the screen anew
            self._lines = lines
            self.query_one("#summary", Static).update(inked("\n".join(lines), app.inks))
        self.query_one(ViewBar).show(self._view, counts, ())
        self._show_message()
        self.refresh_bindings()

    def _show_message(self) -> None:
        """Show the message under the cursor, if it is another one than before."""
        held = self.held.current
        number = None if held is None else held.number
        if number != self._shown:
            self._shown = number
            self.query_one("#change", Input).value = ""
            self._show_bytes(held, b"" if held is None else held.data)

    def _show_bytes(self, held: Held | None, data: bytes) -> None:
        """Show a message as it is or as it would be; the first of its frames."""
        items = parse_datagram(data) if held is not None else ()
        if held is None or not items:
            self.query_one(PacketView).show(None)
            return
        seen = Observation(held.number, 0, 0, held.flow, items[0], 0)
        self.query_one(PacketView).show(seen, held.question)

    def on_resize(self, event: Resize) -> None:
        """Give the message what the list can spare."""
        self.query_one("#message").styles.height = max(9, min(30, event.size.height // 2))

    @on(Lines.Moved)
    def _moved(self, message: Lines.Moved) -> None:
        if message.lines is self.held:
            self._show_message()

    # views

    @on(ViewBar.Wanted)
    def _wanted(self, message: ViewBar.Wanted) -> None:
        self.action_view(message.view)

    def action_view(self, view: str) -> None:
        """Show another list."""
        self._view = view
        self.query_one(ContentSwitcher).current = view
        self.query_one("#adding").display = view == "rules"
        self.query_one("#message").display = view == "held"
        shown = self._list
        head = shown.head() if isinstance(shown, ClientList | RuleList | HeldList) else ""
        self.query_one("#head", Static).update(Text(head, no_wrap=True, overflow="crop"))
        shown.focus()
        self._show_state()

    def action_back(self) -> None:
        """Go from a line to the list."""
        self._list.focus()

    # rules

    def action_switch(self) -> None:
        """Switch the fault under the cursor on or off."""
        rule = self.rules.current
        if rule is not None:
            self._order({"do": "off" if rule.on else "on", "name": rule.name}, _nothing)

    def action_remove(self) -> None:
        """Take the fault under the cursor away."""
        rule = self.rules.current
        if rule is not None:
            self._order({"do": "remove", "name": rule.name}, _nothing)

    def action_add(self) -> None:
        """Go to the line where a fault is typed."""
        self.action_view("rules")
        self.query_one("#fault", Input).focus()

    @on(Input.Changed, "#fault")
    def _fault_typed(self, event: Input.Changed) -> None:
        self._read(event, "#fault-error", read_fault)

    @on(Input.Submitted, "#fault")
    def _fault_entered(self, event: Input.Submitted) -> None:
        if self._read(event, "#fault-error", read_fault) is not None:
            self._order({"do": "add", "rule": event.value.strip()}, self._added)

    def _added(self, answer: Answer) -> None:
        self.query_one("#fault", Input).value = ""
        self._list.focus()

    def _read(self, event: Input.Changed | Input.Submitted, place: str, read: Callable[[str], T]) -> T | None:
        """Read what was typed; None where that is nothing or makes no sense, as is said below the line."""
        error, text, made = self.query_one(place, Static), event.value.strip(), None
        reason = ""
        try:
            made = read(text) if text else None
        except ValueError as wrong:
            reason = str(wrong)
        error.update(Text(reason))
        error.display = bool(reason)
        event.input.set_class(bool(reason), "-invalid")
        return made

    # messages that wait

    @work
    async def action_intercept(self) -> None:
        """Ask which messages are to be held."""
        self.action_view("held")
        known = self._standing.figures.intercept if self._standing is not None else None
        prompt = Prompt(say("proxy.intercept.title"), say("proxy.intercept.hint"), known or "")
        answer = await self.app.push_screen_wait(prompt)
        if answer is not None:
            wanted = {"if": answer.strip()} if answer.strip() else {}
            self._order({"do": "intercept", **wanted}, _nothing)

    def action_forward(self) -> None:
        """Send the message under the cursor on."""
        self._decide("forward", "proxy.sent")

    def action_drop(self) -> None:
        """Drop the message under the cursor."""
        self._decide("drop", "proxy.dropped")

    def _decide(self, do: str, word: str, **more: object) -> None:
        held = self.held.current
        if held is not None:
            text = say(word, number=held.number)
            self._order({"do": do, "number": held.number, **more}, partial(self._decided, text))

    def _decided(self, text: str, answer: Answer) -> None:
        self.query_one(Told).add(text)
        self._list.focus()

    def action_edit(self) -> None:
        """Propose a change of the argument that the cursor of the tree is on."""
        held = self.held.current
        if held is not None:
            self._propose(proposal(held.data, self.query_one(FieldTree).offset_in_frame))

    def action_bytes(self) -> None:
        """Propose all bytes in hex."""
        held = self.held.current
        if held is not None:
            self._propose(held.data.hex(" ").upper())

    def _propose(self, text: str) -> None:
        field = self.query_one("#change", Input)
        with field.prevent(Input.Changed):  # what is proposed changes nothing yet
            field.value = text
        field.cursor_position = len(text)
        field.focus()

    def _changed(self, event: Input.Changed | Input.Submitted) -> bytes | None:
        """Return what becomes of the message by what was typed; None where that makes no sense."""
        held = self.held.current
        if held is None:
            return None
        return self._read(event, "#change-error", partial(edited, held.data, held.flow))

    @on(Input.Changed, "#change")
    def _change_typed(self, event: Input.Changed) -> None:
        """Show what would become of the message."""
        held, made = self.held.current, self._changed(event)
        if held is not None and (made is not None or not event.value.strip()):
            self._show_bytes(held, made or held.data)

    @on(Input.Submitted, "#change")
    def _change_entered(self, event: Input.Submitted) -> None:
        made = self._changed(event)
        if made is not None:
            self._decide("edit", "proxy.edited", hex=made.hex())


def _nothing(answer: Answer) -> None:
    """Do nothing more: the list tells."""
