"""The relay's policy: scripts, intercept, faults and guard, in this order. The guard comes last, so it checks
the bytes that the controller receives. The policy splits a stream into frames only while a rule needs frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

from msgspec.structs import replace

from bcapscope.faults.fault import CloseMode
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.reply_factory import ReplyFactory
from bcapscope.faults.wire_message import FaultOutput, SendBytes, WireMessage
from bcapscope.messages import Message
from bcapscope.messages.places import joined_clauses
from bcapscope.protocol.codec.byte_budget import ByteBudget
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED
from bcapscope.proxy.direction_state import (
    DirectionState,
    UndecidedMessage,
    is_stop_request,
    mark_overtaken,
    may_move,
    split_held_requests,
)
from bcapscope.proxy.intercept import HeldMessage, Intercept
from bcapscope.proxy.policy import CloseAction, PolicyAction, PolicyDecision, SendAction
from bcapscope.proxy.request_guard import RequestGuard
from bcapscope.proxy.rule_report import names_with_counts, report_lines
from bcapscope.proxy.script_protocol import ScriptAnswer
from bcapscope.proxy.script_queue import ScriptDecision, ScriptQueue
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.observation import Conversation, Direction, Flow

_LONGEST_JOINED = 1 << 16
"""Maximum size in bytes of the stream data that the policy joins into one `SendAction`. Without a limit,
joining would be slow, because each added piece copies all previous bytes. Also, the ring loses a record that
is too large (see `_MARGIN` in `ring_buffer`).
"""


class RulePolicy:
    """Decides what happens to each message. A method raises only the exceptions that its docstring names.
    Only `close` may block. Times are in ns of a monotonic clock.

    Attributes:
        refused_requests: Number of requests that the guard or the policy refused. The policy refuses motions
            while the scripts are off, and motions that a stop has overtaken.
        dropped_held: Number of held requests that the proxy dropped because their client no longer waited.
        notify: Function that gets each message for the user.
    """

    def __init__(
        self,
        shaper: FaultInjector,
        guard: RequestGuard | None = None,
        intercept: Intercept | None = None,
        scripts: ScriptQueue | None = None,
        *,
        epoch: int = 0,
    ) -> None:
        """A time of the relay's clock plus `epoch` gives ns since 1970."""
        self.shaper = shaper
        self.intercept = intercept or Intercept()
        self.scripts = scripts
        self.dropped_held = 0
        self.notify: Callable[[Message], None] = lambda message: None
        self._epoch = epoch
        self._clients: dict[int, dict[Direction, DirectionState]] = {}
        self._states: dict[Conversation, dict[Direction, DirectionState]] = {}
        self._budget = ByteBudget()
        self.guard = guard
        self._replies = ReplyFactory()
        self.refused_requests = 0
        self._outbox: list[PolicyAction] = []
        self._message_numbers = itertools.count(1)
        self._recent_requests = RecentRequests()
        self._templates = FrameTemplates()

    def add_client(self, client: int, conversation: Conversation, now: int) -> None:
        self._clients[client] = self._states[conversation] = {
            each: DirectionState(client, Flow(conversation, each), now, self._budget) for each in Direction
        }
        if self.scripts is not None:
            self.scripts.send_connected(client, conversation, now)

    def receive(self, client: int, direction: Direction, data: bytes, now: int) -> PolicyDecision:
        state = self._clients[client][direction]
        state.piece_count += 1
        state.last_piece_at = now
        inspects = self._inspects_frames
        if not inspects and state.splitter is None and self.shaper.is_idle(now):
            state.has_begun = True
            return PolicyDecision(client, [SendAction(client, direction, data)])
        work = PolicyDecision(client)
        for piece in state.cut_messages(data, inspects or self.shaper.needs_frames(now)):
            self._process(state, piece, now, work)
        state.has_begun = True
        return work

    def holds(self, client: int, direction: Direction) -> bool:
        """Return whether the relay must not forward a FIN yet, because rules hold data. The client may
        already have disconnected.
        """
        state = self._clients.get(client, {}).get(direction)
        return state is not None and (
            bool(state.splitter and state.splitter.pending_bytes)
            or self.shaper.holds(state.flow)
            or self.intercept.holds(state.flow)
            or (self.scripts is not None and self.scripts.holds(state.flow))
            or any(not isinstance(action, CloseAction) and action.client == client for action in self._outbox)
        )

    def is_full(self, client: int) -> bool:
        """Return whether the relay must stop reading from a client."""
        return self.shaper.is_full or (self.scripts is not None and self.scripts.is_full(client))

    def on_stream_end(
        self, client: int, direction: Direction, now: int
    ) -> Sequence[SendAction | CloseAction]:
        """Apply the rules to an incomplete frame at the end of a stream."""
        state, work = self._clients[client][direction], PolicyDecision(client)
        state.has_ended = True
        for piece in state.take_incomplete():
            self._process(state, piece, now, work)
        self._mark_abandoned(state)
        return work.actions

    def hides_end(self, client: int) -> bool:
        """Return whether a half-open fault hides each FIN and RST of the client's conversation."""
        state = self._clients.get(client, {}).get(Direction.REQUEST)
        return state is not None and not self.shaper.passes_close(state.flow.conversation)

    def release_held(self, client: int, now: int) -> Sequence[SendAction | CloseAction]:
        """Remove the waiting messages of a client that leaves. Return the actions that the relay must still
        do: actions that were already decided, replies and stops. Drop all other requests. If a half-open
        fault blocks the conversation, drop all waiting messages.
        """
        work = PolicyDecision(client)
        lost: list[Frame | bytes] = []
        for action in self._outbox:
            if action.client == client:
                work.actions += action.actions if isinstance(action, PolicyDecision) else (action,)
        self._outbox = [action for action in self._outbox if action.client != client]
        for direction, state in self._clients[client].items():
            held = self.shaper.pop_held(state.flow)
            held += (each.data for each in self.intercept.remove_held(state.flow))
            held += self.scripts.remove_messages(state.flow) if self.scripts is not None else ()
            held += state.take_incomplete()
            if self.hides_end(client):
                continue
            if direction is Direction.REQUEST and held:
                held, dropped = split_held_requests(state, held)
                lost += dropped
            for data in held:
                self._send(state, data, Message("held.sent-at-end"), work)
        if lost:
            who = self._clients[client][Direction.REQUEST].flow.conversation.client
            self.notify(Message("held.lost", client=str(who), messages=names_with_counts(lost)))
            self.dropped_held += len(lost)
        return work.actions

    def remove_client(self, client: int, now: int) -> None:
        self.release_held(client, now)
        conversation = self._clients.pop(client)[Direction.REQUEST].flow.conversation
        del self._states[conversation]
        for each in (self._replies, self.shaper, self.intercept, self._recent_requests):
            each.close_conversation(conversation)
        if self.scripts is not None:
            self.scripts.send_gone(client, now)

    def due(self) -> int | None:
        """Return the time at which to call `pop_due_actions`; None while nothing waits."""
        if self._outbox:
            return 0
        times = [self.shaper.due(), self.intercept.due(), self.scripts.due() if self.scripts else None]
        return min((time for time in times if time is not None), default=None)

    def pop_due_actions(self, now: int) -> Sequence[PolicyAction]:
        if self.scripts is not None:
            self._apply_script_decisions(self.scripts.advance(now, now + self._epoch), now)
        actions, self._outbox = self._outbox, []
        for held in self.intercept.pop_expired(now):
            seconds = f"{(held.until - held.since) / 1e9:g}"
            why = held.abandonment_reason(now)
            if why is not None:
                note = Message("held.undecided.dropped", seconds=seconds, reason=why)
            else:
                note = Message("held.undecided.sent", seconds=seconds)
            self.notify(Message("held.message", number=held.number, note=note))
            if why is not None:
                self.dropped_held += 1
            else:
                actions += self._forward_held(held, held.data, note, now)
        work = PolicyDecision(0)
        self._carry_out(self.shaper.advance(now), work)
        return [*actions, *work.actions]

    def close(self, now: int) -> None:
        """End the scripts, and wait for their process."""
        if self.scripts is not None:
            self.scripts.finish(now)

    def report(self) -> Sequence[Message]:
        return report_lines(self)

    def on_script_data(self, data: bytes, now: int) -> None:
        """Apply the decisions in `data`, which the scripts' process has sent. Empty `data` means that the
        scripts' process has ended. `pop_due_actions` returns the resulting actions.
        """
        if self.scripts is not None:
            decisions = self.scripts.on_data(data, now) if data else self.scripts.on_process_ended(now)
            self._apply_script_decisions(decisions, now)

    def clients(self) -> Iterator[tuple[DirectionState, DirectionState]]:
        """Yield the states of each client's requests and responses."""
        return ((each[Direction.REQUEST], each[Direction.RESPONSE]) for each in self._clients.values())

    def on_rules_changed(self, now: int) -> None:
        """If no rule needs whole frames any more, forward the incomplete frames. Call this method after a
        change of the faults or of the intercept.
        """
        if self._inspects_frames or self.shaper.needs_frames(now):
            return
        split = [state for pair in self.clients() for state in pair if state.splitter is not None]
        for state in split:
            work = PolicyDecision(state.client)
            for rest in state.cut_messages(b"", into_frames=False):
                self._process(state, rest, now, work)
            self._outbox += work.actions

    def forward_held(self, number: int, now: int, data: bytes | None = None) -> None:
        """Forward a held message, or `data` in its place, through faults and guard. If no message with this
        number is held, raise a `KeyError`.
        """
        held = self.intercept.release(number, now, data)
        case = "held.sent" if data is None or data == held.data else "held.edited"
        note = Message(case, time=f"{(now - held.since) / 1e9:.1f} s")
        self._outbox += self._forward_held(held, held.data if data is None else data, note, now)

    def drop_held(self, number: int, now: int) -> None:
        """Drop a held message and its retries. If no message with this number is held, raise a `KeyError`."""
        self.intercept.release(number, now, b"")

    @property
    def _inspects_frames(self) -> bool:
        if self.scripts is not None and self.scripts.inspects_frames:
            return True
        return self.guard is not None or not self.intercept.is_idle

    def _process(self, state: DirectionState, data: bytes, now: int, work: PolicyDecision) -> None:
        if self._inspects_frames:
            message = self._message(next(self._message_numbers), state.flow, data, now)
            self._replies.on_message(state.flow, data)
            passing = self._show_to_scripts(state, message, work)
            if passing is not None:
                self._intercept_and_fault(state, passing, now, work)
        else:
            self._apply_faults(state, data, now, work)

    def _show_to_scripts(
        self, state: DirectionState, message: WireMessage, work: PolicyDecision
    ) -> WireMessage | None:
        """Pass a message to the scripts. Return what to forward now; None to forward nothing."""
        scripts = self.scripts
        if scripts is None or not scripts.inspects_frames:
            return message
        if not scripts.is_on:
            return self._pass_without_scripts(state, message, work)
        decides = scripts.decides(state.flow.direction)
        if not decides or is_stop_request(message):
            if decides:
                mark_overtaken(message, state, (up for up, _ in self.clients()))
            scripts.show_message(state.client, message, None)
            return message
        if message.is_datagram and not scripts.has_room(state.client):
            work.notes.append(Message("addon.dropped.too-many"))
            return None
        work.waiting += 1
        scripts.show_message(state.client, message, UndecidedMessage(message, state, work))
        return None

    def _apply_script_decisions(self, decisions: Iterable[ScriptDecision], now: int) -> None:
        for (message, state, decision), answer in decisions:
            work = PolicyDecision(state.client)
            if answer is None:
                passing = self._pass_without_scripts(state, message, work)
            else:
                passing = self._apply_script_answer(state, message, answer, work)
                if passing is not None and message.number < state.overtaken_by:
                    passing = self._without_motion(state, passing, Message("script.overtaken"), work)
            if passing is not None:
                self._intercept_and_fault(state, passing, now, work)
            decision.waiting -= 1
            decision.notes += work.notes
            if decision.waiting:
                self._outbox += work.actions
            else:
                decision.actions = work.actions
                self._outbox.append(decision)

    def _apply_script_answer(
        self, state: DirectionState, message: WireMessage, answer: ScriptAnswer, work: PolicyDecision
    ) -> WireMessage | None:
        for code in answer.results:
            for frame in message.frames:
                self._answer(state, frame, code, Message("addon.answered"), work)
        if answer.dropped:
            work.notes.append(Message("addon.answered" if answer.results else "addon.dropped"))
            return None
        if answer.data is None:
            return message
        work.notes.append(Message("addon.changed"))
        return self._message(message.number, message.flow, answer.data, message.now)

    def _pass_without_scripts(
        self, state: DirectionState, message: WireMessage, work: PolicyDecision
    ) -> WireMessage | None:
        if state.flow.direction is Direction.RESPONSE:
            return message
        return self._without_motion(state, message, Message("script.is-off"), work)

    def _without_motion(
        self, state: DirectionState, message: WireMessage, note: Message, work: PolicyDecision
    ) -> WireMessage | None:
        """Refuse the frames that may move the robot. Return the rest of the message, or None if all was
        refused.
        """
        items = [each.observation.item for each in message.annotated_frames]
        refused = [item for item in items if isinstance(item, Frame) and may_move(item)]
        if not refused:
            return message
        self._refuse(state, refused, note, work)
        work.notes.append(note)
        passing = b"".join(item.raw for item in items if item not in refused)
        return self._message(message.number, message.flow, passing, message.now) if passing else None

    def _message(self, number: int, flow: Flow, data: bytes, now: int) -> WireMessage:
        message = WireMessage(number, flow, data, now, now + self._epoch, templates=self._templates)
        message.annotate(self._recent_requests)
        return message

    def _intercept_and_fault(
        self, state: DirectionState, message: WireMessage, now: int, work: PolicyDecision
    ) -> None:
        passed = self.intercept.hold_or_pass(state.client, message)
        self._mark_abandoned(state)
        data: bytes | None = message.data
        if passed is not None:
            note, data = passed
            work.notes.append(note)
        if data is not None:
            self._apply_faults(state, data, now, work)

    def _forward_held(
        self, held: HeldMessage, data: bytes, note: Message, now: int
    ) -> list[SendAction | CloseAction]:
        state, work = self._clients[held.client][held.flow.direction], PolicyDecision(held.client)
        self._apply_faults(state, data, now, work)
        return [
            replace(action, note=note) if isinstance(action, SendAction) and action.note is None else action
            for action in work.actions
        ]

    def _mark_abandoned(self, state: DirectionState) -> None:
        if state.has_ended and state.flow.direction is Direction.REQUEST:
            self.intercept.mark_abandoned(state.flow, Message("held.client-ended"))

    def _apply_faults(self, state: DirectionState, data: bytes, now: int, work: PolicyDecision) -> None:
        processed = self.shaper.process_message(state.flow, data, now)
        work.notes += processed.fault_notes
        self._carry_out(processed.outputs, work)

    def _carry_out(self, outputs: Sequence[FaultOutput], work: PolicyDecision) -> None:
        for output in outputs:
            note = joined_clauses(output.fault_notes)
            if isinstance(output, SendBytes):
                state = self._states[output.conversation][output.flow.direction]
                self._send(state, output.data, note, work)
            else:
                client = self._states[output.conversation][Direction.REQUEST].client
                assert note is not None
                work.actions.append(CloseAction(client, output.how is CloseMode.RESET, note))

    def _send(self, state: DirectionState, data: bytes, note: Message | None, work: PolicyDecision) -> None:
        """Forward a message, except requests in it that the guard refuses. In a stream, join successive
        pieces that no rule changed.
        """
        direction = state.flow.direction
        if self.guard is not None and direction is Direction.REQUEST:
            data, refused, dropped = self.guard.filter_frames(data)
            for frame, why in refused:
                work.notes.append(Message("guard.answered", reason=why))
                self._refuse(state, (frame,), Message("guard.refused", reason=why), work)
            if dropped:
                work.notes.append(Message("guard.dropped"))
            if not data:
                return
        last = work.actions[-1] if work.actions and state.is_stream and note is None else None
        if (
            isinstance(last, SendAction)
            and last == SendAction(state.client, direction, last.data)
            and len(last.data) + len(data) <= _LONGEST_JOINED
        ):
            work.actions[-1] = SendAction(state.client, direction, last.data + data)
        else:
            work.actions.append(SendAction(state.client, direction, data, note))

    def _refuse(
        self, state: DirectionState, requests: Sequence[Frame], note: Message, work: PolicyDecision
    ) -> None:
        self.refused_requests += len(requests)
        for request in requests:
            self._answer(state, request, E_ACCESSDENIED, note, work)

    def _answer(
        self, state: DirectionState, request: Frame, code: int, note: Message, work: PolicyDecision
    ) -> None:
        """Reply to a request in place of the controller, with a result code and no value."""
        raw = self._replies.make_reply(state.flow.conversation, request, code)
        work.actions.append(SendAction(state.client, Direction.RESPONSE, raw, note))
