"""Applies faults to each message, with seeded random numbers. This module uses no socket and no clock.

With the same seed, the same messages at the same times get the same faults. The random numbers of a fault
depend only on the seed and on the fault's name. A fault draws random numbers for every message that matches
its conditions, even if another fault drops the message. An added fault therefore does not change the
decisions of other faults.

Each fault gets the messages with the changes that earlier faults made. If a fault drops a message, answers a
request or has the action `pass`, later faults do not get the message.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable
from operator import itemgetter
from typing import Any, TypeAlias

from bcapscope.errors import InputError
from bcapscope.faults.attempt_counter import AttemptCounter
from bcapscope.faults.fault import CloseMode, Fault
from bcapscope.faults.fault_kinds import AnyFault
from bcapscope.faults.fault_matcher import FaultMatcher
from bcapscope.faults.reply_factory import ReplyFactory
from bcapscope.faults.rewriter import Rewriter
from bcapscope.faults.wire_message import (
    CloseConnection,
    FaultedMessage,
    FaultOutput,
    FaultResult,
    SendBytes,
    WireMessage,
)
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport

MAX_WAITING = 16 << 20
"""Maximum total size in bytes of the messages that faults hold: about one second of traffic at 100 Mbit/s.
Beyond the limit, faults drop datagrams instead of holding them, like tc-netem(8) with a full queue.
"""

_OUTPUT_COST = 300  # bytes of memory that a held message needs in addition to its data

_FlowKey: TypeAlias = tuple[Conversation, Direction]


class ActiveFault(FaultMatcher):
    fault: AnyFault

    def __init__(self, fault: AnyFault, name: str, seed: int, now: int) -> None:
        super().__init__(fault, name, seed, now)
        self.state = fault.initial_state()


class _QueuedOutput:
    """A `FaultOutput` in the queue of the `FaultInjector`.

    Attributes:
        output: The `FaultOutput`; None after it was sent, or has moved to another `_QueuedOutput`.
        size: Number of bytes that this output adds to the total for `MAX_WAITING`.
    """

    __slots__ = ("output", "size")

    def __init__(self, output: FaultOutput) -> None:
        self.output: FaultOutput | None = output
        self.size = _OUTPUT_COST + (len(output.data) if isinstance(output, SendBytes) else 0)

    @property
    def conversation(self) -> Conversation | None:
        return self.output.conversation if self.output else None


class FaultInjector:
    """Applies faults to messages. `active_faults` has the faults in the order in which they are applied."""

    def __init__(self, faults: Iterable[AnyFault] = (), *, seed: int = 0, now: int, epoch: int = 0) -> None:
        """Set up the faults. If two faults have the same name, raise an `InputError`. In all methods, `now`
        is in ns of a monotonic clock. For filters, `now` plus `epoch` is in ns since 1970-01-01 UTC.
        """
        self.active_faults: list[ActiveFault] = []
        self._seed = seed
        self._epoch = epoch
        self._message_count = 0
        self._templates = FrameTemplates()
        self._recent_requests = RecentRequests()
        self._attempt_counter = AttemptCounter()
        self._reply_factory = ReplyFactory()
        self._queue: list[tuple[int, int, _QueuedOutput]] = []
        self._sequence = itertools.count()
        self._queued_bytes = 0
        self._stream_busy_until: dict[_FlowKey, int] = {}
        # The reordered messages. The number says how many more messages must overtake the message.
        self._held_behind: dict[_FlowKey, list[tuple[_QueuedOutput, int]]] = {}
        self._half_open: dict[Conversation, Message] = {}
        for fault in faults:
            self.add(fault, now)

    def add(self, fault: AnyFault, now: int) -> str:
        """Append a fault, and return its name. If another fault has the same name, raise an `InputError`."""
        names = {active.name for active in self.active_faults}
        if fault.name in names:
            raise InputError(Message("fault.exists", name=fault.name))
        name = fault.name or _generated_name(fault, names)
        self.active_faults.append(ActiveFault(fault, name, self._seed, now))
        return name

    def remove(self, name: str) -> None:
        """Remove a fault. The messages that the fault has delayed are still sent at their planned time. If no
        fault has this name, raise a `KeyError`.
        """
        self.active_faults.remove(self.find(name))

    def set_enabled(self, name: str, enabled: bool) -> None:
        """Switch a fault on or off. If no fault has this name, raise a `KeyError`."""
        self.find(name).enabled = enabled

    def find(self, name: str) -> ActiveFault:
        """Return a fault by its name. If no fault has this name, raise a `KeyError`."""
        for active in self.active_faults:
            if active.name == name:
                return active
        raise KeyError(name)

    @property
    def hit_counts(self) -> dict[str, int]:
        return {active.name: active.hit_count for active in self.active_faults}

    def is_idle(self, now: int) -> bool:
        """Return True if the injector need not see messages, because it would forward them unchanged."""
        return (
            not self._queue
            and not self._half_open
            and not any(active.can_hit(now) for active in self.active_faults)
        )

    def needs_frames(self, now: int) -> bool:
        """Return whether `process_message` must get the single frames of TCP streams."""
        return any(active.fault.needs_frames for active in self.active_faults if active.can_hit(now))

    def process_message(self, flow: Flow, data: bytes, now: int) -> FaultResult:
        """Apply the faults to a datagram, to a frame of a stream, or to bytes of a stream that are not a
        frame. All messages of a direction must have the same `Flow` object.
        """
        outputs = self.advance(now) if self._queue else []
        if flow.conversation in self._half_open:
            return FaultResult(outputs, (self._half_open[flow.conversation],))
        if not self.active_faults:
            return self._pass_unchanged(flow, data, now, outputs)
        self._message_count += 1
        number, time = self._message_count, now + self._epoch
        message = WireMessage(number, flow, data, now, time, templates=self._templates)
        if any(active.needs_pairing for active in self.active_faults):
            message.annotate_with_attempts(self._recent_requests, self._attempt_counter)
        self._reply_factory.on_message(flow, data)
        hits = self._draw_hits(message)
        if not hits:
            return self._pass_unchanged(flow, data, now, outputs)
        work = FaultedMessage(message, self._reply_factory, data)
        touched = tuple(self._apply_hits(work, hits))
        if work.half_open:
            self._half_open[flow.conversation] = touched[-1]
        if self.is_full and message.is_datagram and not work.is_lost:
            touched = (*touched, *_drop_beyond_limit(work))
        self._schedule(work, touched)
        return FaultResult(outputs + self.advance(now), touched)

    def due(self) -> int | None:
        """Return the time in ns at which to call `advance`; None if nothing is held."""
        return self._queue[0][0] if self._queue else None

    @property
    def is_full(self) -> bool:
        """Whether the messages that faults hold exceed `MAX_WAITING` bytes. The proxy then should not read
        from TCP streams.
        """
        return self._queued_bytes > MAX_WAITING

    def advance(self, now: int) -> list[FaultOutput]:
        """Return the outputs that are due at `now`, in the order of sending."""
        outputs: list[FaultOutput] = []
        while self._queue and self._queue[0][0] <= now:
            queued = heapq.heappop(self._queue)[2]
            self._queued_bytes -= queued.size
            if queued.output is not None:
                outputs.append(queued.output)
                queued.output = None
        return outputs

    def holds(self, flow: Flow) -> bool:
        """Return whether a FIN of the flow must not be forwarded yet, because faults hold messages of the
        flow or block the conversation.
        """
        return not self.passes_close(flow.conversation) or any(
            _is_of(queued.output, _flow_key(flow)) for _, _, queued in self._queue
        )

    def passes_close(self, conversation: Conversation) -> bool:
        """Return False if a half-open fault blocks the conversation, including its FINs and RSTs."""
        return conversation not in self._half_open

    def pop_held(self, flow: Flow) -> list[bytes]:
        """Remove all held messages of one direction. Return their bytes in the planned order of sending, or
        nothing if a half-open fault blocks the conversation.
        """
        key = _flow_key(flow)
        found = [entry for entry in self._queue if _is_of(entry[2].output, key)]
        self._queue = [entry for entry in self._queue if not _is_of(entry[2].output, key)]
        self._rebuild_queue()
        self._stream_busy_until.pop(key, None)
        self._held_behind.pop(key, None)
        if flow.conversation in self._half_open:
            return []
        outputs = [queued.output for _, _, queued in sorted(found, key=itemgetter(0, 1))]
        return [output.data for output in outputs if isinstance(output, SendBytes)]

    def close_conversation(self, conversation: Conversation) -> None:
        self._half_open.pop(conversation, None)
        self._reply_factory.close_conversation(conversation)
        self._recent_requests.close_conversation(conversation)
        self._attempt_counter.close_conversation(conversation)
        for active in self.active_faults:
            if isinstance(active.state, Rewriter):
                active.state.close_conversation(conversation)
        for direction in Direction:
            self._stream_busy_until.pop((conversation, direction), None)
            self._held_behind.pop((conversation, direction), None)
        waiting = [entry for entry in self._queue if entry[2].output]
        self._queue = [entry for entry in waiting if entry[2].conversation is not conversation]
        self._rebuild_queue()

    def _rebuild_queue(self) -> None:
        heapq.heapify(self._queue)
        self._queued_bytes = sum(queued.size for _, _, queued in self._queue)

    def _draw_hits(self, message: WireMessage) -> list[tuple[ActiveFault, Any]]:
        hits = []
        for active in self.active_faults:
            if active.matches(message) and active.draw():
                drawn = active.fault.draw(active, message)
                if drawn is not None:
                    hits.append((active, drawn))
        return hits

    def _apply_hits(self, faulted: FaultedMessage, hits: list[tuple[ActiveFault, Any]]) -> Iterable[Message]:
        for active, drawn in hits:
            if faulted.is_final:
                return
            what = active.fault.apply(faulted, drawn, active)
            if what is not None:
                active.count_hit()
                yield Message("fault.did", name=active.name, what=what)

    def _pass_unchanged(self, flow: Flow, data: bytes, now: int, outputs: list[FaultOutput]) -> FaultResult:
        if not self._queue:
            outputs.append(SendBytes(flow, data))
            return FaultResult(outputs)
        self._enqueue_send(flow, SendBytes(flow, data), now)
        return FaultResult(outputs + self.advance(now))

    def _schedule(self, faulted: FaultedMessage, notes: tuple[Message, ...]) -> None:
        message = faulted.original
        flow, now = message.flow, message.now
        back = Flow(flow.conversation, Direction.RESPONSE)
        for late, raw in faulted.replies:
            self._enqueue_send(back, SendBytes(back, raw, notes), now + late)
        if faulted.close_mode is not None:
            closing = CloseConnection(flow.conversation, faulted.close_mode, notes)
            self._enqueue(self._close_time(closing, now + faulted.delay), _QueuedOutput(closing))
        if faulted.is_lost:
            return
        send = SendBytes(flow, faulted.data, notes)
        if faulted.held_behind is None:
            self._enqueue_send(flow, send, now + faulted.delay)
        else:
            behind, patience = faulted.held_behind
            queued = _QueuedOutput(send)
            self._held_behind.setdefault(_flow_key(flow), []).append((queued, behind))
            self._enqueue(now + faulted.delay + patience, queued)
        for late in faulted.copy_delays:
            self._enqueue_send(flow, send, now + faulted.delay + late)

    def _close_time(self, closing: CloseConnection, when: int) -> int:
        """Return the time in ns at which to close a connection. A reset closes the connection at `when`. A
        FIN closes the connection after all held messages of the connection are sent.
        """
        if closing.how is CloseMode.RESET:
            return when
        held = (due for due, _, each in self._queue if each.conversation is closing.conversation)
        return max((when, *held))

    def _enqueue_send(self, flow: Flow, send: SendBytes, due: int) -> None:
        """Queue bytes for sending at `due`. In a stream, the bytes never overtake earlier bytes. Then queue
        each reordered message that enough later messages have overtaken.
        """
        key = _flow_key(flow)
        if flow.conversation.transport is Transport.TCP:
            self._stream_busy_until[key] = due = max(due, self._stream_busy_until.get(key, due))
        self._enqueue(due, _QueuedOutput(send))
        still_behind = []
        for queued, behind in self._held_behind.pop(key, ()):
            if queued.output is not None and behind > 1:
                still_behind.append((queued, behind - 1))
            elif queued.output is not None:
                self._enqueue(due, _QueuedOutput(queued.output))
                queued.output = None
        if still_behind:
            self._held_behind[key] = still_behind

    def _enqueue(self, due: int, queued: _QueuedOutput) -> None:
        self._queued_bytes += queued.size
        heapq.heappush(self._queue, (due, next(self._sequence), queued))


def _drop_beyond_limit(faulted: FaultedMessage) -> Iterable[Message]:
    """Drop a datagram that faults would delay, because the held messages exceed `MAX_WAITING` bytes. If
    faults delay only copies of the datagram, keep the datagram and drop its delayed copies.
    """
    if faulted.delay or faulted.held_behind:
        faulted.drop()
        yield Message("fault.dropped.too-much")
    elif any(faulted.copy_delays):
        faulted.copy_delays = [late for late in faulted.copy_delays if not late]
        yield Message("fault.copies-dropped")


def _generated_name(fault: Fault, names: set[str]) -> str:
    number = 1
    while (name := fault.action if number == 1 else f"{fault.action}-{number}") in names:
        number += 1
    return name


def _flow_key(flow: Flow) -> _FlowKey:
    return flow.conversation, flow.direction


def _is_of(output: FaultOutput | None, key: _FlowKey) -> bool:
    return isinstance(output, SendBytes) and _flow_key(output.flow) == key
