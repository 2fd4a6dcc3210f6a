"""The relay's policy: scripts, intercept, faults and guard, in this order.

The guard comes last, right before the controller, so it sees what the others made of a message.

Nothing here reads a clock or a socket. A stream is cut into frames only while something must see them; else
its bytes pass as they come.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from msgspec.structs import replace

from bcapscope.faults.answers import Manners
from bcapscope.faults.fault import Ending
from bcapscope.faults.message import Message, Output
from bcapscope.faults.message import Send as Sent
from bcapscope.faults.shaper import Shaper
from bcapscope.protocol.budget import Budget
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import E_ACCESSDENIED
from bcapscope.proxy.guard import Guard
from bcapscope.proxy.hook import Action, Close, Decision, LateDecision, Send
from bcapscope.proxy.intercept import Held, Intercept
from bcapscope.proxy.rulereport import names_of, report_lines
from bcapscope.proxy.scriptqueue import ScriptDecision, ScriptQueue
from bcapscope.proxy.scriptwire import Answer
from bcapscope.proxy.unscripted import is_stop, mark_overtaken, without_motion
from bcapscope.proxy.way import Asked, Attendance, Way, Work, joined, part
from bcapscope.traffic.observation import Conversation, Direction, Flow
from bcapscope.traffic.question import Questions


class Rules:
    """Decides what happens to each message.

    Attributes:
        shaper: the faults.
        guard: what requests it refuses; None for none.
        intercept: what is held.
        scripts: the user's own; None without.
        refused: requests that the guard has refused, motions while the scripts are off, and motions that
            a stop has overtaken.
        lost: requests that were held until their client no longer waited, and were dropped.
        tell: is given a line for the user.
    """

    def __init__(
        self,
        shaper: Shaper,
        guard: Guard | None = None,
        intercept: Intercept | None = None,
        scripts: ScriptQueue[Asked] | None = None,
        *,
        epoch: int = 0,
    ) -> None:
        """Set them up.

        Args:
            shaper: with or without faults.
            guard: refuses requests.
            intercept: holds messages.
            scripts: see messages.
            epoch: what to add to the clock's ns for those since 1970.
        """
        self.shaper = shaper
        self.guard = guard
        self.intercept = intercept or Intercept()
        self.scripts = scripts
        self.refused = 0
        self.lost = 0
        self.tell: Callable[[str], None] = lambda text: None
        self._epoch = epoch
        self._ways: dict[int, dict[Direction, Way]] = {}
        self._since: dict[int, int] = {}
        self._numbers: dict[Conversation, int] = {}
        self._outbox: list[Action] = []
        self._messages = 0
        self._budget = Budget()
        self._questions, self._manners = Questions(), Manners()
        self._tickets = 0

    # as the relay's policy

    def opened(self, client: int, conversation: Conversation, now: int) -> None:
        """Meet a client."""
        self._ways[client] = {side: Way(client, Flow(conversation, side), self._budget) for side in Direction}
        self._numbers[conversation] = client
        self._since[client] = now
        if self.scripts is not None:
            self.scripts.connected(client, conversation, now)

    def receive(self, client: int, direction: Direction, data: bytes, now: int) -> Decision:
        """Decide about a datagram, or the next bytes of a stream."""
        way = self._ways[client][direction]
        way.pieces += 1
        way.last = now
        looks = self._looks
        if not looks and way.splitter is None and self.shaper.idle(now):
            way.begun = True
            return Decision("", (Send(client, direction, data),))
        work = Work()
        for piece in way.cut(data, looks or self.shaper.needs_frames(now)):
            self._process(way, piece, now, work)
        way.begun = True
        actions = joined(work.actions, way)
        if work.waiting:
            return Decision("", actions, work.ticket)
        return Decision(work.note, actions)

    def holds(self, client: int, direction: Direction) -> bool:
        """Tell whether something of this direction is still to be sent; nothing of a client that is gone."""
        if client not in self._ways:
            return False
        way = self._ways[client][direction]
        return (
            bool(way.splitter and way.splitter.pending)
            or self.shaper.holds(way.flow)
            or self.intercept.holds(way.flow)
            or (self.scripts is not None and self.scripts.holds(way.flow))
            or any(not isinstance(action, Close) and action.client == client for action in self._outbox)
        )

    def is_full(self, client: int) -> bool:
        """Return whether so much is held that the client's streams must not be read."""
        return self.shaper.is_full or (self.scripts is not None and self.scripts.is_full(client))

    def ended(self, client: int, direction: Direction, now: int) -> Sequence[Send | Close]:
        """Let go of a frame that breaks off where a stream has ended."""
        way, work = self._ways[client][direction], Work()
        way.ended = True
        for piece in way.rest():
            self._process(way, piece, now, work)
        self._pass_over(way)
        return joined(work.actions, way)

    def hides_end(self, client: int) -> bool:
        """Tell whether neither side of a client may hear of the other's end."""
        ways = self._ways.get(client)
        return ways is not None and not self.shaper.passes_end(ways[Direction.REQUEST].flow.conversation)

    def let_go(self, client: int, now: int) -> Sequence[Send | Close]:
        """Give out what is still held of a client that is to end, or forget it.

        Answers go on, and requests that stop the robot or let go of something; all other requests do not.
        """
        work = Work()
        lost: list[Frame | bytes] = []
        for action in self._outbox:
            if action.client == client:
                work.actions += action.actions if isinstance(action, LateDecision) else (action,)
        self._outbox = [action for action in self._outbox if action.client != client]
        for direction, way in self._ways[client].items():
            held = self.shaper.abandon(way.flow)
            held += (each.data for each in self.intercept.abandon(way.flow))
            held += self.scripts.abandon(way.flow) if self.scripts is not None else ()
            held += way.rest()
            if self.hides_end(client):
                continue
            if direction is Direction.REQUEST and held:
                held, left = part(way, held)
                lost += left
            for data in held:
                self._emit(way, data, "sent on, as it ends", work)
        if lost:
            who = self._ways[client][Direction.REQUEST].flow.conversation.client
            self.tell(f"{who} ended; held messages that were not sent: {names_of(lost)}")
            self.lost += len(lost)
        return work.actions

    def gone(self, client: int, now: int) -> None:
        """Forget a client."""
        ways = self._ways.pop(client)
        for way in ways.values():
            self.intercept.abandon(way.flow)
        way = ways[Direction.REQUEST]
        conversation = way.flow.conversation
        del self._numbers[conversation], self._since[client]
        self._manners.forget(conversation)
        self.shaper.forget(conversation)
        self.intercept.forget(conversation)
        self._questions.forget(conversation)
        self._outbox = [action for action in self._outbox if action.client != client]
        if self.scripts is not None:
            for each in ways.values():
                self.scripts.abandon(each.flow)
            self.scripts.gone(client, now)

    def due(self) -> int | None:
        """Tell when `take` is to be called."""
        if self._outbox:
            return 0
        times = [self.shaper.due(), self.intercept.due(), self.scripts.due() if self.scripts else None]
        return min((time for time in times if time is not None), default=None)

    def take(self, now: int) -> Sequence[Action]:
        """Give out what is to be done by now."""
        if self.scripts is not None:
            self._decide(self.scripts.advance(now, now + self._epoch), now)
        outbox, self._outbox = self._outbox, []
        work = Work()
        for held in self.intercept.expired(now):
            waited = f"intercept: nobody decided in {(held.until - held.since) / 1e9:g} s"
            why = held.given_up(now)
            note = f"{waited} and {why}, dropped" if why else f"{waited}, sent on unchanged"
            self.tell(f"message {held.number}: {note}")
            if why:
                self.lost += 1
            else:
                self._send_on(held, held.data, note, now, work)
        self._translate(self.shaper.advance(now), work)
        return [*outbox, *work.actions]

    def close(self, now: int) -> None:
        """Let the scripts end, and wait until they have."""
        if self.scripts is not None:
            self.scripts.finish(now)

    def report(self) -> Sequence[str]:
        """Sum up what the rules did."""
        return report_lines(self)

    # for the process of the scripts

    def hear_scripts(self, data: bytes, now: int) -> None:
        """Take what came from the scripts' process; `take` gives out what becomes of what waited."""
        if self.scripts is not None:
            self._decide(self.scripts.receive(data, now), now)

    def lose_scripts(self, now: int) -> None:
        """Handle the end of the scripts' process."""
        if self.scripts is not None:
            self._decide(self.scripts.lost(now), now)

    # for the control socket and the screen

    def clients(self) -> Iterator[Attendance]:
        """Yield who is there."""
        for number, ways in self._ways.items():
            up, down = ways[Direction.REQUEST], ways[Direction.RESPONSE]
            counts = up.pieces, up.last, down.pieces, down.last
            yield Attendance(number, up.flow.conversation, self._since[number], *counts)

    def changed(self, now: int) -> None:
        """Take notice that faults or the intercept have changed; what was kept for them only goes on."""
        if self._looks or self.shaper.needs_frames(now):
            return
        kept = [way for ways in self._ways.values() for way in ways.values() if way.splitter is not None]
        for way in kept:
            work = Work()
            for rest in way.cut(b"", into_frames=False):
                self._process(way, rest, now, work)
            self._outbox += work.actions

    def send_on(self, number: int, now: int, data: bytes | None = None) -> None:
        """Send on a message that is held, as it came or edited. The guard and the faults see it still.

        Raises:
            KeyError: nothing of this number is held.
        """
        held = self.intercept.release(number, now, data)
        done = "sent on" if data is None or data == held.data else "edited"
        note = f"intercept: {done} after {(now - held.since) / 1e9:.1f} s"
        work = Work()
        self._send_on(held, held.data if data is None else data, note, now, work)
        self._outbox += work.actions

    def drop(self, number: int, now: int) -> None:
        """Drop a message that is held, and its retries.

        Raises:
            KeyError: nothing of this number is held.
        """
        self.intercept.release(number, now, b"")

    # messages

    @property
    def _looks(self) -> bool:
        if self.scripts is not None and self.scripts.looks:
            return True
        return self.guard is not None or not self.intercept.is_idle

    def _process(self, way: Way, data: bytes, now: int, work: Work) -> None:
        if self._looks:
            self._messages += 1
            message = Message(self._messages, way.flow, data, now, now + self._epoch)
            message.ask(self._questions)
            self._manners.see(way.flow, data)
            left = self._shown(way, message, work)
            if left is not None:
                self._go_on(way, left, now, work)
        else:
            self._go(way, data, now, work)

    def _shown(self, way: Way, message: Message, work: Work) -> Message | None:
        """Show a message to the scripts; give what goes on of it now, without waiting for them."""
        scripts = self.scripts
        if scripts is None or not scripts.looks:
            return message
        if not scripts.is_on:
            return self._unscripted(way, message, work)
        decides = scripts.decides(way.flow.direction)
        if not decides or is_stop(message):
            if decides:
                mark_overtaken(message, way, (ways[Direction.REQUEST] for ways in self._ways.values()))
            scripts.show(way.client, message, None)
            return message
        if message.datagram and not scripts.has_room(way.client):
            work.notes.append("addon: dropped, too many messages wait")
            return None
        if not work.ticket:
            self._tickets += 1
            work.ticket = self._tickets
        work.waiting += 1
        scripts.show(way.client, message, Asked(way, work))
        return None

    def _decide(self, decisions: Iterable[ScriptDecision[Asked]], now: int) -> None:
        """Forward messages that the scripts have decided about, or failed to decide about in time."""
        for decision in decisions:
            (way, came), message, work = decision.token, decision.message, Work()
            if decision.answer is None:
                left = self._unscripted(way, message, work)
            else:
                left = self._as_answered(way, message, decision.answer, work)
                if left is not None and message.number < way.overtaken:
                    left = self._without_motion(way, left, "overtaken by a stop: motion is refused", work)
            if left is not None:
                self._go_on(way, left, now, work)
            came.waiting -= 1
            came.notes += work.notes
            if came.waiting:
                self._outbox += work.actions
            else:
                actions = joined(work.actions, way)
                self._outbox.append(LateDecision(way.client, came.ticket, came.note, actions))

    def _as_answered(self, way: Way, message: Message, answer: Answer, work: Work) -> Message | None:
        """Give what the scripts leave of a message."""
        for code in answer.results:
            self._answer(way, message.frames, code, "addon: answered", work)
        if answer.dropped:
            work.notes.append("addon: answered" if answer.results else "addon: dropped")
            return None
        return message if answer.data is None else self._changed(message, answer.data, "addon: changed", work)

    def _unscripted(self, way: Way, message: Message, work: Work) -> Message | None:
        """Return the parts of a message that pass while the scripts are off: all but motion."""
        if way.flow.direction is Direction.RESPONSE:
            return message
        return self._without_motion(way, message, "script is off: motion is refused", work)

    def _without_motion(self, way: Way, message: Message, note: str, work: Work) -> Message | None:
        """Refuse the motions in a request; give the rest of it."""
        passing, refused = without_motion(told.seen.item for told in message.told)
        if not refused:
            return message
        self.refused += len(refused)
        self._answer(way, refused, E_ACCESSDENIED, note, work)
        if passing:
            return self._changed(message, passing, note, work)
        work.notes.append(note)
        return None

    def _changed(self, message: Message, data: bytes, note: str, work: Work) -> Message:
        """Make the message that goes on in place of another."""
        work.notes.append(note)
        changed = Message(message.number, message.flow, data, message.now, message.time)
        changed.ask(self._questions)
        return changed

    def _go_on(self, way: Way, message: Message, now: int, work: Work) -> None:
        """Pass a message through the intercept and the faults."""
        going = self._intercepted(way, message, work)
        if going is not None:
            self._go(way, going, now, work)

    def _intercepted(self, way: Way, message: Message, work: Work) -> bytes | None:
        """Give what the intercept lets pass of a message now; None for nothing."""
        considered = self.intercept.consider(way.client, message)
        self._pass_over(way)
        if considered is None:
            return message.data
        work.notes.append(considered.note)
        return considered.data

    def _send_on(self, held: Held, data: bytes, note: str, now: int, work: Work) -> None:
        way = self._ways[held.client][held.flow.direction]
        own = Work()
        self._go(way, data, now, own)
        work.actions += [
            replace(action, note=note) if isinstance(action, Send) and not action.note else action
            for action in own.actions
        ]

    def _pass_over(self, way: Way) -> None:
        """Let the intercept know that a client that has ended its connection waits for nothing."""
        if way.ended and way.flow.direction is Direction.REQUEST:
            self.intercept.pass_over(way.flow, "its client's connection has ended")

    def _go(self, way: Way, data: bytes, now: int, work: Work) -> None:
        """Pass a message through the faults."""
        taken = self.shaper.take(way.flow, data, now)
        work.notes += taken.touched
        self._translate(taken.outputs, work)

    def _emit(self, way: Way, data: bytes, note: str, work: Work) -> None:
        """Send what is left of a message; what is for the controller as far as the guard lets it."""
        number, direction = way.client, way.flow.direction
        if self.guard is not None and direction is Direction.REQUEST:
            data = self._guarded(self.guard, way, data, work)
            if not data:
                return
        work.actions.append(Send(number, direction, data, note))

    def _guarded(self, guard: Guard, way: Way, data: bytes, work: Work) -> bytes:
        """Give what the guard leaves of a request; the rest is answered in the controller's place."""
        passing, refused, dropped = guard.sift(data)
        for frame, why in refused:
            self.refused += 1
            work.notes.append(f"guard: {why}, answered with E_ACCESSDENIED")
            self._answer(way, (frame,), E_ACCESSDENIED, f"guard: {why}", work)
        if dropped:
            work.notes.append("guard: dropped bytes that are no frame")
        return passing

    def _answer(self, way: Way, requests: Sequence[Frame], code: int, note: str, work: Work) -> None:
        for request in requests:
            raw = self._manners.answer(way.flow.conversation, request, code)
            work.actions.append(Send(way.client, Direction.RESPONSE, raw, note))

    def _translate(self, outputs: Sequence[Output], work: Work) -> None:
        for output in outputs:
            note = "; ".join(output.touched)
            if isinstance(output, Sent):
                flow = output.flow
                way = self._ways[self._numbers[flow.conversation]][flow.direction]
                self._emit(way, output.data, note, work)
            else:
                number = self._numbers[output.conversation]
                work.actions.append(Close(number, output.how is Ending.RESET, note))
