"""Proxy: who is there, faults on and off, messages held and changed, how long it holds what passes."""

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
from bcapscope.faults.notation import read_fault
from bcapscope.protocol.frame import parse_datagram
from bcapscope.proxy.control_answers import Answer, Held
from bcapscope.proxy.control_client import ControlRefused
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Observation
from bcapscope.tui.app import scope_of
from bcapscope.tui.child import Child
from bcapscope.tui.ink import INK
from bcapscope.tui.proxy.asking import Asker
from bcapscope.tui.proxy.editing import edited, proposal
from bcapscope.tui.proxy.lists import ClientList, HeldList, RuleList, Told
from bcapscope.tui.proxy.news import Obeyed, Said, Stands
from bcapscope.tui.proxy.standing import Standing
from bcapscope.tui.proxy.summary import intercepts, summary
from bcapscope.tui.screens.prompt import Prompt
from bcapscope.tui.screens.views import Views, view_keys
from bcapscope.tui.traffic.feed import Feed
from bcapscope.tui.widgets.checkedline import CheckedLine
from bcapscope.tui.widgets.fieldtree import FieldTree
from bcapscope.tui.widgets.ground import Deck, Stack
from bcapscope.tui.widgets.inked import InkedText
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.packet import PacketView
from bcapscope.tui.widgets.viewbar import ViewBar
from bcapscope.tui.words import say, told

EVERY = 0.5
"""Seconds between two questions how the proxy stands."""

_OF_RULES = frozenset({"switch", "remove"})
_OF_HELD = frozenset({"forward", "drop", "edit", "bytes"})


class ProxyScreen(Views):
    """Shows a proxy and tells it what to do."""

    NAME = "proxy"
    ABOUT = "proxy.about"
    AUTO_FOCUS = "#clients"
    VIEWS: ClassVar[Mapping[str, str]] = {
        "clients": "proxy.clients",
        "rules": "proxy.rules",
        "held": "proxy.held",
        "told": "proxy.told",
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
        way: str,
        feed: Feed | None = None,
        child: Child | None = None,
        note: str = "",
    ) -> None:
        """Take the proxy.

        Args:
            address: of its control socket.
            way: where it listens and where that leads, for people.
            feed: what passes, where that is shown: it is told when nothing more will.
            child: the proxy itself, where the screen has started it.
            note: what is to be said at first; "" for nothing.
        """
        super().__init__()
        self._asker = Asker(address)
        self.way = way
        self._feed = feed
        self._child = child
        self._note = note
        self._standing: Standing | None = None
        self._trouble = ""
        self._is_over = False
        self._lines: list[str] = []
        self._shown: int | None = None

    def content(self) -> ComposeResult:
        """Yield what is true of all of it, then the lists."""
        yield InkedText(id="summary")
        yield self.bar()
        yield Static(id="head")
        with Deck(initial="clients", id="lists"):
            yield ClientList(id="clients")
            yield RuleList(id="rules")
            yield HeldList(id="held")
            yield Told(id="told")
        yield CheckedLine("fault", read_fault, say("proxy.add.hint"))
        with Stack(id="message"):
            yield InkedText(id="intercepts")
            yield PacketView(id="packet")
            yield CheckedLine("change", self._changed, say("proxy.edit.hint"))

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
        self._asker.close()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer what has to do with a rule or a message only where one is."""
        if action in _OF_RULES:
            return self.view == "rules" and self.rules.current is not None
        if action in _OF_HELD:
            return self.view == "held" and self.held.current is not None
        return True

    # asking and telling

    @work(thread=True, group="poll", exclusive=True)
    def _poll(self) -> None:
        """Ask how the proxy stands."""
        if not self._is_over:
            self.post_message(self._ask_all())

    def _ask_all(self) -> Stands:
        """Ask; in a thread, as it may wait."""
        try:
            return Stands(self._asker.standing())
        except BcapError as error:
            return Stands(None, str(error))

    @work(thread=True, group="order")
    def _order(self, question: Mapping[str, object], done: Callable[[Answer], None]) -> None:
        """Have the proxy do something; `done` is called when it has."""
        try:
            self.post_message(Obeyed(partial(done, self._asker.order(question))))
        except ControlRefused as error:
            text = say("proxy.refusal", reason=printable(told(str(error))))
            self.post_message(Obeyed(partial(scope_of(self).tell, text, "error")))
        except BcapError as error:
            self.post_message(Stands(None, str(error)))
        self.post_message(self._ask_all())

    def on_obeyed(self, message: Obeyed) -> None:
        """Do what is next."""
        message.stop()
        message.then()

    def on_stands(self, message: Stands) -> None:
        """Show how the proxy stands."""
        message.stop()
        if self._is_over:
            return
        if message.standing is None:
            if not self._trouble:
                text = say("proxy.gone", reason=printable(told(message.trouble)))
                scope_of(self).tell(text, "error")
                self._doubt(text)
            self._trouble = message.trouble
        else:
            if self._trouble:
                self._doubt("")
            self._trouble = ""
            self._standing = message.standing
            self.clients.show(message.standing.clients)
            self.rules.show(message.standing.rules)
            self.held.show(message.standing.held)
        self.show_state()

    def _doubt(self, why: str) -> None:
        """Let whoever looks at what passes know why nothing more may."""
        if self._feed is not None:
            self._feed.doubt(why)

    def on_said(self, message: Said) -> None:
        """Show what the proxy said."""
        message.stop()
        if message.is_end:
            reason = printable(told(message.text)) or say("proxy.no_words")
            self._is_over = True
            self._trouble = say("proxy.ended", reason=reason)
            scope_of(self).tell(self._trouble, "error")
            self._doubt(self._trouble)
            if self._feed is not None:
                self._feed.stop()
        else:
            self.query_one(Told).add(told(message.text))
        self.show_state()

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

    def show_state(self) -> None:
        """Show how the proxy stands, and the message under the cursor."""
        app, standing = scope_of(self), self._standing
        key, ink = ("proxy.not_here", "bad") if self._trouble else ("proxy.here", "good")
        waiting = (
            ""
            if standing is None or not standing.held or self._is_over
            else f" · {say('proxy.waiting', count=len(standing.held))}"
        )
        app.status = ((f"{say(key, way=printable(self.way))}{waiting} ", ink),)
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
            self.query_one("#intercepts", InkedText).write(intercepts(standing.figures))
        if lines != self._lines:  # its height may be another, which is to lay out the screen anew
            self._lines = lines
            self.query_one("#summary", InkedText).write("\n".join(lines))
        self.query_one(ViewBar).show(self.view, counts, ())
        self._show_message()
        self.refresh_bindings()

    def _show_message(self) -> None:
        """Show the message under the cursor, if it is another one than before."""
        held = self.held.current
        number = None if held is None else held.number
        if number != self._shown:
            self._shown = number
            self._change.propose("")
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

    def show_view(self) -> None:
        """Show what is above the columns, and below them what belongs to them."""
        self.query_one("#fault-line").display = self.view == "rules"
        self.query_one("#message").display = self.view == "held"
        shown = self.seen
        head = shown.head() if isinstance(shown, ClientList | RuleList | HeldList) else ""
        self.query_one("#head", Static).update(Text(head, no_wrap=True, overflow="crop"))

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
        self.set_focus(self.query_one("#fault"))

    @on(CheckedLine.Entered, "#fault-line")
    def _fault_entered(self, message: CheckedLine.Entered) -> None:
        if message.text:
            self._order({"do": "add", "rule": message.text}, self._added)

    def _added(self, answer: Answer) -> None:
        self.query_one("#fault-line", CheckedLine).propose("")
        self.set_focus(self.seen)

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
        self.set_focus(self.seen)

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

    @property
    def _change(self) -> CheckedLine:
        return self.query_one("#change-line", CheckedLine)

    def _propose(self, text: str) -> None:
        self._change.propose(text)  # what is proposed changes nothing yet
        self.set_focus(self._change.field)

    def _changed(self, text: str) -> bytes | None:
        """Return what becomes of the message by what was typed; None where there is no message any more."""
        held = self.held.current
        return None if held is None else edited(held.data, held.flow, text)

    @on(CheckedLine.Typed, "#change-line")
    def _change_typed(self, message: CheckedLine.Typed) -> None:
        """Show what would become of the message."""
        held, made = self.held.current, message.made
        if held is not None:
            self._show_bytes(held, made if isinstance(made, bytes) else held.data)

    @on(CheckedLine.Entered, "#change-line")
    def _change_entered(self, message: CheckedLine.Entered) -> None:
        if isinstance(message.made, bytes):
            self._decide("edit", "proxy.edited", hex=message.made.hex())


def _nothing(answer: Answer) -> None:
    """Do nothing more: the list tells."""
