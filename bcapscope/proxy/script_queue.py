"""The queue of messages that wait for the scripts, and the time limit for the scripts. Times are in ns of a
monotonic clock.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from bcapscope.faults.wire_message import WireMessage
from bcapscope.messages import Message
from bcapscope.messages.places import joined_clauses
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.proxy.direction_state import UndecidedMessage
from bcapscope.proxy.script_protocol import (
    ClientConnected,
    ClientGone,
    ExpireCalls,
    FinishScripts,
    FrameUnpacker,
    MessageShown,
    ScriptAnswer,
    ScriptOrder,
    ScriptStatement,
    WireError,
    pack,
)
from bcapscope.traffic.observation import Conversation, Direction, Flow

if TYPE_CHECKING:
    from bcapscope.proxy.script_process import ScriptProcess

TIME_LIMIT_NS = 100_000_000
"""Default time in ns that the scripts may take for one message."""

LONGEST_WAIT = 1_000_000_000
"""Maximum time in ns from the arrival of a message to the scripts' decision, unless the user's time limit is
longer.
"""

MAX_WAITING = 64
"""Maximum number of waiting datagrams per client. One call needs at most eight datagrams, one per attempt."""

MAX_BYTES = 1 << 16
"""Maximum number of waiting bytes per client. Above this limit, the proxy does not read the client's stream,
and drops the client's datagrams.
"""

MAX_BYTES_IN_ALL = 1 << 22
"""Above this number of waiting bytes of all clients, the scripts get only messages that need a decision."""

_LATE = 20_000_000
"""If the relay is late by more than this time in ns, the scripts get more time: a busy computer may delay the
scripts too.
"""

_LOCATED_WITHIN_NS = 50_000_000
"""After switching the scripts off, the proxy waits this time in ns before it kills the scripts' process.
During this time, the process can report the script line that it is executing.
"""

_EXPIRE_INTERVAL_NS = 50_000_000
"""Minimum time in ns from one `ExpireCalls` order to the next."""

MAX_NOTICES = 200
"""The proxy shows the user at most this many messages from the scripts."""


@dataclass(slots=True)
class PendingOrder:
    """A `ScriptOrder` that the scripts have not answered yet. `undecided` is None if the `message` needs no
    decision.
    """

    hook: str
    sent_at: int
    message: WireMessage | None = None
    undecided: UndecidedMessage | None = None

    @property
    def size(self) -> int:
        return 0 if self.message is None else len(self.message.data)

    def __str__(self) -> str:
        names = [call_name(each.code, each.variants) for each in self.message.frames] if self.message else []
        if self.hook != "request" or not names:
            return self.hook
        return f"{self.hook} ({names[0][:80]})"


ScriptDecision: TypeAlias = tuple[UndecidedMessage, ScriptAnswer | None]
"""A message, and the answer of the scripts; None if the scripts were switched off before they answered."""


class ScriptQueue:
    """Passes messages to the scripts, in order, and returns their decisions. The queue switches the scripts
    off if they exceed the time limit for a message, or if their process ends or sends invalid data.
    `off_because` is the reason. `notify` gets each message for the user.
    """

    _head_since: int  # since when the scripts work on the first order of the queue

    def __init__(self, names: str, process: ScriptProcess, limit: int = TIME_LIMIT_NS) -> None:
        """Create a queue with a time `limit` in ns per message."""
        self.names = names
        self.is_on = True
        self.off_because: Message | None = None
        self.errors = 0
        self.notify: Callable[[Message], None] = lambda message: None
        self._process = process
        self._limit = limit
        self._hooks: frozenset[str] = frozenset()
        self._queue: deque[PendingOrder] = deque()
        self._answers: FrameUnpacker[ScriptStatement] = FrameUnpacker(ScriptStatement)
        self._counts: Counter[int] = Counter()  # number of messages that wait for a decision, by client
        self._sizes: Counter[int] = Counter()
        self._size = self._waiting_size = 0
        self._was_late = False
        self._has_open_calls = False
        self._expire_at = 0
        self._end_at: int | None = None
        self._notice_count = 0
        self._is_ending = self._is_end_reported = False

    def on_loaded(self, hooks: Iterable[str]) -> None:
        self._hooks = frozenset(hooks)

    @property
    def status(self) -> str:
        return "on" if self.is_on else f"off: {self.off_because}"

    @property
    def inspects_frames(self) -> bool:
        """Whether streams must be split into frames, because hooks need frames, or because the proxy refuses
        motions while the scripts are off.
        """
        return not self.is_on or not self._hooks.isdisjoint(("request", "reply", "settled"))

    def decides(self, direction: Direction) -> bool:
        return self.is_on and ("request" if direction is Direction.REQUEST else "reply") in self._hooks

    def send_connected(self, client: int, conversation: Conversation, now: int) -> None:
        ends = conversation.client, conversation.server
        self._send_order(
            ClientConnected(client, ends, conversation.transport), PendingOrder("connected", now)
        )

    def show_message(self, client: int, message: WireMessage, undecided: UndecidedMessage | None) -> None:
        """Pass a message to the scripts. If `undecided` is None, the scripts only see the message, which the
        proxy forwards without their decision. Otherwise, `undecided` waits in the queue until the scripts
        decide.
        """
        up = message.flow.direction is Direction.REQUEST
        if undecided is None:
            unwanted = not up and self._hooks.isdisjoint(("reply", "settled"))
            if unwanted or self._size > MAX_BYTES_IN_ALL:
                return
        self._send_order(
            MessageShown(client, up, message.data, message.now, message.time),
            PendingOrder("request" if up else "reply", message.now, message, undecided),
        )

    def send_gone(self, client: int, now: int) -> None:
        """Call `remove_messages` first."""
        self._send_order(ClientGone(client), PendingOrder("gone", now))

    def finish(self, now: int) -> None:
        """Wait for the last answers of the scripts, and end their process."""
        self._is_ending = True
        if self.is_on:
            self._enqueue(PendingOrder("done", now))
            if not self._process.finish(pack(FinishScripts()), self._is_finished) and self.is_on:
                self._switch_off(Message("script.slow-end", order=str(self._queue[0])), now)
        self._end_process()

    def on_data(self, data: bytes, now: int) -> Iterator[ScriptDecision]:
        """Handle bytes that arrived from the scripts' process. Yield the decisions in these bytes."""
        if not self.is_on:
            return
        self._answers.feed_bytes(data)
        try:
            while (answer := self._answers.next_frame()) is not None:
                if not isinstance(answer, ScriptAnswer) or not self._queue:
                    raise WireError(Message("script.wire.unexpected"))
                yield from self._on_answer(answer, now)
        except WireError as error:
            self._switch_off(Message("script.invalid", reason=error.message), now)
            yield from self._flush_undecided()

    def on_process_ended(self, now: int) -> Iterator[ScriptDecision]:
        """Switch the scripts off. Yield each waiting message, with None instead of an answer."""
        if self.is_on:
            why = Message("script.ended-between")
            if self._queue:
                why = Message("script.ended-during", order=str(self._queue[0]))
            self._switch_off(why, now)
            yield from self._flush_undecided()

    def due(self) -> int | None:
        if not self.is_on:
            return self._end_at
        if self._queue:
            longest = self._queue[0].sent_at + max(LONGEST_WAIT, self._limit)
            return min(self._head_since + self._limit, longest)
        return self._expire_at if self._has_open_calls else None

    def advance(self, now: int, time: int) -> Iterator[ScriptDecision]:
        """Check whether the scripts exceeded the time limit, and whether calls expired. Yield the resulting
        decisions. `time` is the current time in ns since 1970.
        """
        due = self.due()
        if due is None or now < due:
            return
        if not self.is_on:
            self._end_process()
        elif not self._queue:
            self._expire_at = now + _EXPIRE_INTERVAL_NS
            self._send_order(ExpireCalls(time), PendingOrder("settled", now))
        else:
            # An answer that arrived in time counts, even if the relay reads it too late.
            yield from self.on_data(self._process.receive() or b"", now)
            due = self.due()
            if not self.is_on or not self._queue or due is None or now < due:
                return
            # If the relay itself was late, extend the time limit, but only once per answer.
            if now - due > _LATE and not self._was_late:
                self._was_late = True
                self._extend_limits(now - due + self._limit)
            else:
                self._switch_off(self._slow_reason(now), now)
                yield from self._flush_undecided()

    def holds(self, flow: Flow) -> bool:
        return any(each.undecided is not None and each.undecided.state.flow is flow for each in self._queue)

    def is_full(self, client: int) -> bool:
        """Return whether the proxy must stop reading a client's stream."""
        return self._sizes[client] > MAX_BYTES or self._waiting_size > MAX_BYTES_IN_ALL

    def has_room(self, client: int) -> bool:
        return not self.is_full(client) and self._counts[client] < MAX_WAITING

    def remove_messages(self, flow: Flow) -> list[bytes]:
        """For each message of `flow` that waits for a decision, return its data. From now on, ignore the
        scripts' decisions about these messages.
        """
        found: list[bytes] = []
        for each in self._queue:
            if each.undecided is not None and each.undecided.state.flow is flow:
                found.append(each.undecided.message.data)
                self._count(each, -1)
                each.undecided = None
        return found

    def _send_order(self, order: ScriptOrder, waiting: PendingOrder) -> None:
        if self.is_on:
            self._enqueue(waiting)
            self._process.send(pack(order))

    def _enqueue(self, waiting: PendingOrder) -> None:
        if not self._queue:
            self._head_since = waiting.sent_at
        self._queue.append(waiting)
        self._size += waiting.size
        self._count(waiting, 1)

    def _dequeue(self) -> PendingOrder:
        waiting = self._queue.popleft()
        self._size -= waiting.size
        self._count(waiting, -1)
        return waiting

    def _on_answer(self, answer: ScriptAnswer, now: int) -> Iterator[ScriptDecision]:
        waiting = self._dequeue()
        self._head_since = now
        self._was_late = False
        self._has_open_calls = answer.has_open_calls
        self.errors = max(self.errors, answer.errors)
        for notice in answer.notices:
            self._notice_count += 1
            if self._notice_count <= MAX_NOTICES:
                self.notify(notice.message)
        if waiting.undecided is not None:
            yield waiting.undecided, answer

    def _count(self, waiting: PendingOrder, sign: int) -> None:
        """Add a message to the counts and sizes of the messages that wait for a decision. With a `sign` of
        -1, remove the message from them. If the message does not wait for a decision, do nothing.
        """
        if waiting.undecided is not None:
            client = waiting.undecided.state.client
            self._counts[client] += sign
            self._sizes[client] += sign * waiting.size
            self._waiting_size += sign * waiting.size
            if not self._counts[client]:
                del self._counts[client], self._sizes[client]

    def _flush_undecided(self) -> Iterator[ScriptDecision]:
        while self._queue:
            undecided = self._dequeue().undecided
            if undecided is not None:
                yield undecided, None

    def _slow_reason(self, now: int) -> Message:
        if now - self._head_since >= self._limit:
            time = f"{self._limit / 1e6:g} ms"
            return Message("script.slow", time=time, order=str(self._queue[0]))
        waited = max(LONGEST_WAIT, self._limit) / 1e9
        return Message("script.cannot-keep-up", time=f"{waited:g} s")

    def _extend_limits(self, extra: int) -> None:
        self._head_since += extra
        for each in self._queue:
            each.sent_at += extra

    def _switch_off(self, why: Message, now: int) -> None:
        self.is_on = False
        self.off_because = why
        self._end_at = now + _LOCATED_WITHIN_NS
        self._process.locate()

    def _end_process(self) -> None:
        """End the process. If the scripts were switched off, report the reason to the user."""
        self._end_at = None
        where = self._process.end()
        if self.off_because is not None and not self._is_end_reported:
            self._is_end_reported = True
            self.off_because = joined_clauses((self.off_because, *where))
            assert self.off_because is not None
            case = "script.switched-off" if self._is_ending else "script.switched-off.consequence"
            self.notify(Message(case, names=self.names, reason=self.off_because))

    def _is_finished(self, data: bytes) -> bool:
        for _ in self.on_data(data, self._head_since):
            pass  # all clients are gone, so the decisions have no effect
        return not self._queue
