"""All that looks into what passes: addons, intercept, guard and faults, in this order: the relay's policy.

Nothing here reads a clock or a socket. A stream is cut into frames only while something must see them; else
its bytes pass as they come.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from bcapscope.faults.answers import Manners
from bcapscope.faults.fault import Ending
from bcapscope.faults.message import Message, Output
from bcapscope.faults.message import Send as Sent
from bcapscope.faults.shaper import Shaper
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import E_ACCESSDENIED
from bcapscope.protocol.stream import Splitter
from bcapscope.proxy.addons import Addons, Client
from bcapscope.proxy.guard import Guard
from bcapscope.proxy.hook import Action, Close, Decision, Send
from bcapscope.proxy.intercept import MOST_HELD, Held, Intercept
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport
from bcapscope.traffic.question import Questions

_SETTLE = 50_000_000
"""ns between looks for calls that have settled, as the tracker itself has it."""


class _Way:
    """One direction of a client.

    Attributes:
        flow: for filters and faults.
        client: whose.
        splitter: of a stream, while something must see its frames.
        begun: bytes have passed.
        pieces: datagrams, or reads of a stream, that came.
        last: when the last of them came; ns.
    """

    __slots__ = ("begun", "client", "flow", "last", "pieces", "splitter")

    def __init__(self, client: Client, flow: Flow) -> None:
        self.client = client
        self.flow = flow
        self.splitter: Splitter | None = None
        self.begun = False
        self.pieces = self.last = 0

    @property
    def is_stream(self) -> bool:
        """Whether frames must be cut out of it."""
        return self.flow.conversation.transport is Transport.TCP


class Attendance(NamedTuple):
    """A client that is there.

    Attributes:
        number: of the client.
        conversation: between the client and the controller.
        since: ns.
        up: datagrams, or reads of a stream, that came from the client.
        heard: when the last of them came, ns; 0 for never.
        down: those that came from the controller.
        answered: when the last of them came, ns; 0 for never.
    """

    number: int
    conversation: Conversation
    since: int
    up: int
    heard: int
    down: int
    answered: int


class _Work:
    """What is done about one piece of what came: actions in order, and what is said of it."""

    __slots__ = ("actions", "notes")

    def __init__(self) -> None:
        self.actions: list[Action] = []
        self.notes: list[str] = []


class Rules:
    """Decides what becomes of what passes.

    Attributes:
        shaper: the faults.
        guard: what requests it refuses; None for none.
        intercept: what is held.
        addons: the user's own.
        refused: requests that the guard has refused.
        tell: is given a line for the user.
    """

    def __init__(
        self,
        shaper: Shaper,
        guard: Guard | None = None,
        intercept: Intercept | None = None,
        addons: Addons | None = None,
        *,
        epoch: int = 0,
    ) -> None:
        """Set them up.

        Args:
            shaper: with or without faults.
            guard: refuses requests.
            intercept: holds messages.
            addons: see messages.
            epoch: what to add to the clock's ns for those since 1970.
        """
        self.shaper = shaper
        self.guard = guard
        self.intercept = intercept or Intercept()
        self.addons = addons or Addons(())
        self.refused = 0
        self.tell: Callable[[str], None] = lambda text: None
        self._epoch = epoch
        self._ways: dict[int, dict[Direction, _Way]] = {}
        self._since: dict[int, int] = {}
        self._numbers: dict[Conversation, int] = {}
        self._outbox: list[Action] = []
        self._messages = 0
        self._questions, self._manners = Questions(), Manners()
        self._settle_at = 0

    # as the relay's policy

    def opened(self, client: int, conversation: Conversation, now: int) -> None:
        """Meet a client."""
        told = Client(client, conversation.client, conversation.server, conversation.transport)
        self._ways[client] = {side: _Way(told, Flow(conversation, side)) for side in Direction}
        self._numbers[conversation] = client
        self._since[client] = now
        self.addons.connected(told)

    def receive(self, client: int, direction: Direction, data: bytes, now: int) -> Decision:
        """Decide about a datagram, or the next bytes of a stream."""
        way = self._ways[client][direction]
        way.pieces += 1
        way.last = now
        looks = self._looks
        if not looks and way.splitter is None and self.shaper.idle(now):
            way.begun = True
            return Decision("", (Send(client, direction, data),))
        work = _Work()
        for piece in self._pieces(way, data, looks or self.shaper.needs_frames(now)):
            self._process(way, piece, now, work)
        way.begun = True
        return Decision("; ".join(dict.fromkeys(work.notes)), _joined(work.actions, way))

    def holds(self, client: int, direction: Direction) -> bool:
        """Tell whether something of this direction is still to be sent; nothing of a client that is gone."""
        if client not in self._ways:
            return False
        way = self._ways[client][direction]
        return (
            bool(way.splitter and way.splitter.pending)
            or self.shaper.holds(way.flow)
            or self.intercept.holds(way.flow)
            or any(isinstance(action, Send) and action.client == client for action in self._outbox)
        )

    def is_full(self) -> bool:
        """Tell whether so much is held that no stream is to be read."""
        return self.shaper.is_full

    def ended(self, client: int, direction: Direction, now: int) -> Sequence[Action]:
        """Let go of a frame that breaks off where a stream has ended."""
        way, work = self._ways[client][direction], _Work()
        if way.splitter is not None:
            for piece in way.splitter.close():
                self._process(way, piece.item.raw, now, work)
        return _joined(work.actions, way)

    def gone(self, client: int, now: int) -> None:
        """Forget a client."""
        ways = self._ways.pop(client)
        way = ways[Direction.REQUEST]
        conversation = way.flow.conversation
        del self._numbers[conversation], self._since[client]
        self._manners.forget(conversation)
        self.shaper.forget(conversation)
        self.intercept.forget(client)
        self._outbox = [action for action in self._outbox if action.client != client]
        self.addons.gone(way.client)

    def due(self) -> int | None:
        """Tell when `take` is to be called."""
        if self._outbox:
            return 0
        times = [self.shaper.due(), self.intercept.due(), self._settle_at if self.addons.waits else None]
        return min((time for time in times if time is not None), default=None)

    def take(self, now: int) -> Sequence[Action]:
        """Give out what is to be done by now."""
        work = _Work()
        work.actions, self._outbox = self._outbox, []
        for held in self.intercept.expired(now):
            waited = f"intercept: nobody decided in {self.intercept.patience / 1e9:g} s, sent on unchanged"
            self.tell(f"message {held.number}: {waited}")
            self._send_on(held, held.data, waited, now, work)
        self._translate(self.shaper.advance(now), work)
        if self.addons.waits and now >= self._settle_at:
            self._settle_at = now + _SETTLE
            self.addons.expire(now + self._epoch)
        return work.actions

    def close(self) -> None:
        """Take notice that the proxy ends."""
        self.addons.done()

    def report(self) -> Sequence[str]:
        """Sum up what the rules did."""
        lines = [f"fault {name}: struck {_times(count)}" for name, count in self.shaper.counts.items()]
        if self.guard is not None:
            lines.append(f"guard: refused {_times(self.refused)}")
        if self.intercept.count:
            lines.append(f"intercept: held {_times(self.intercept.count)}")
        if self.addons.errors:
            lines.append(f"scripts: went wrong {_times(self.addons.errors)}")
        return lines

    # for the control socket and the screen

    def clients(self) -> Iterator[Attendance]:
        """Yield who is there."""
        for number, ways in self._ways.items():
            up, down = ways[Direction.REQUEST], ways[Direction.RESPONSE]
            yield Attendance(
                number,
                up.flow.conversation,
                self._since[number],
                up.pieces,
                up.last,
                down.pieces,
                down.last,
            )

    def changed(self, now: int) -> None:
        """Take notice that faults or the intercept have changed; what was kept for them only goes on."""
        if self._looks or self.shaper.needs_frames(now):
            return
        kept = [way for ways in self._ways.values() for way in ways.values() if way.splitter is not None]
        for way in kept:
            work = _Work()
            for rest in self._pieces(way, b"", cut=False):
                self._process(way, rest, now, work)
            self._outbox += work.actions

    def send_on(self, number: int, now: int, data: bytes | None = None) -> None:
        """Send on a message that is held, as it came or edited. The guard and the faults see it still.

        Raises:
            KeyError: nothing of this number is held.
        """
        held = self.intercept.release(number)
        done = "sent on" if data is None or data == held.data else "edited"
        note = f"intercept: {done} after {(now - held.since) / 1e9:.1f} s"
        work = _Work()
        self._send_on(held, held.data if data is None else data, note, now, work)
        self._outbox += work.actions

    def drop(self, number: int) -> None:
        """Drop a message that is held.

        Raises:
            KeyError: nothing of this number is held.
        """
        self.intercept.release(number)

    # messages

    @property
    def _looks(self) -> bool:
        return self.guard is not None or self.intercept.condition is not None or self.addons.looks

    def _pieces(self, way: _Way, data: bytes, cut: bool) -> Iterator[bytes]:
        """Cut what came into messages, as far as something must see them."""
        if not way.is_stream:
            yield data
            return
        if cut:
            if way.splitter is None:
                way.splitter = Splitter(in_step=not way.begun)
            for piece in way.splitter.feed(data):
                yield piece.item.raw
            return
        splitter, way.splitter = way.splitter, None
        rest = b"".join(piece.item.raw for piece in splitter.close()) if splitter else b""
        if rest or data:
            yield rest + data

    def _process(self, way: _Way, data: bytes, now: int, work: _Work) -> None:
        if self._looks:
            self._messages += 1
            message = Message(self._messages, way.flow, data, now, now + self._epoch)
            message.ask(self._questions)
            self._manners.see(way.flow, data)
            left = self._shown(way, message, work)
            if left is None or self._held(way, left, work):
                return
            data = left.data
        self._go(way, data, now, work)

    def _shown(self, way: _Way, message: Message, work: _Work) -> Message | None:
        """Show a message to the addons; give what they leave of it."""
        if not self.addons.looks:
            return message
        passing = self.addons.see(way.client, message)
        for code in passing.answers:
            self._answer(way, message.frames, code, "addon: answered", work)
        if passing.dropped:
            work.notes.append("addon: answered" if passing.answers else "addon: dropped")
            return None
        if passing.data == message.data:
            return message
        work.notes.append("addon: changed")
        changed = Message(message.number, way.flow, passing.data, message.now, message.now + self._epoch)
        changed.ask(self._questions)
        return changed

    def _held(self, way: _Way, message: Message, work: _Work) -> bool:
        if not self.intercept.wants(message):
            return False
        if self.intercept.is_full:
            work.notes.append(f"intercept: not held, {MOST_HELD} are held already")
            return False
        held = self.intercept.hold(way.client.number, message)
        work.notes.append(f"intercept: held as {held.number}")
        return True

    def _send_on(self, held: Held, data: bytes, note: str, now: int, work: _Work) -> None:
        way = self._ways[held.client][held.flow.direction]
        own = _Work()
        self._go(way, data, now, own)
        work.actions += [
            action._replace(note=note) if isinstance(action, Send) and not action.note else action
            for action in own.actions
        ]

    def _go(self, way: _Way, data: bytes, now: int, work: _Work) -> None:
        """Pass a message through the guard and the faults."""
        if self.guard is not None and way.flow.direction is Direction.REQUEST:
            data = self._guarded(self.guard, way, data, work)
            if not data:
                return
        taken = self.shaper.take(way.flow, data, now)
        work.notes += taken.touched
        self._translate(taken.outputs, work)

    def _guarded(self, guard: Guard, way: _Way, data: bytes, work: _Work) -> bytes:
        """Give what the guard leaves of a request; the rest is answered in the controller's place."""
        passing = []
        for told in Message(0, way.flow, data, 0, 0).told:
            item = told.seen.item
            if not isinstance(item, Frame):
                if guard.read_only:
                    work.notes.append("guard: read-only: dropped bytes that are no frame")
                else:
                    passing.append(item.raw)
                continue
            why = guard.refuses(item)
            if why:
                self.refused += 1
                work.notes.append(f"guard: {why}, answered with E_ACCESSDENIED")
                self._answer(way, (item,), E_ACCESSDENIED, f"guard: {why}", work)
            else:
                passing.append(item.raw)
        return b"".join(passing)

    def _answer(self, way: _Way, requests: Sequence[Frame], code: int, note: str, work: _Work) -> None:
        for request in requests:
            raw = self._manners.answer(way.flow.conversation, request, code)
            work.actions.append(Send(way.client.number, Direction.RESPONSE, raw, note))

    def _translate(self, outputs: Sequence[Output], work: _Work) -> None:
        for output in outputs:
            note = "; ".join(output.touched)
            if isinstance(output, Sent):
                flow = output.flow
                number = self._numbers[flow.conversation]
                work.actions.append(Send(number, flow.direction, output.data, note))
            else:
                number = self._numbers[output.conversation]
                work.actions.append(Close(number, output.how is Ending.RESET, note))


def _times(count: int) -> str:
    return {0: "never", 1: "once"}.get(count, f"{count} times")


def _joined(actions: list[Action], way: _Way) -> Sequence[Action]:
    """Join bytes of a stream that pass untouched into one piece again, as they came."""
    if not way.is_stream or len(actions) < 2:
        return actions
    joined: list[Action] = []
    for action in actions:
        last = joined[-1] if joined else None
        if (
            isinstance(action, Send)
            and isinstance(last, Send)
            and not action.note
            and not last.note
            and action[:2] == last[:2]
        ):
            joined[-1] = last._replace(data=last.data + action.data)
        else:
            joined.append(action)
    return joined
