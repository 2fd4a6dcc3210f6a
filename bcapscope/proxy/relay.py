"""The relay: one thread that moves bytes between clients and controllers without inspecting them. The relay
writes all traffic into a ring buffer, which another process reads.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.message_codec import encode_message
from bcapscope.proxy.admission import ClientSlots
from bcapscope.proxy.pending_connections import PendingConnections
from bcapscope.proxy.policy import PolicyAction, PolicyDecision, SendAction
from bcapscope.proxy.poller import DescriptorWatcher, open_ticker, wait_precisely
from bcapscope.proxy.relay_session import ClientEndpoints, ClientListener, RelaySession
from bcapscope.proxy.ring_buffer import RelayCounter, RingRecordKind, RingWriter
from bcapscope.proxy.sockets import should_report
from bcapscope.traffic.observation import Direction, Endpoint, Transport
from bcapscope.transport.descriptors import SpareDescriptors

if TYPE_CHECKING:
    from bcapscope.proxy.rule_policy import RulePolicy

POLL_INTERVAL = 0.05
"""Interval in seconds at which the relay writes pending records and checks whether to stop."""

SWEEP_EVERY = 20
"""Number of `POLL_INTERVAL` periods between two searches for silent clients and full buffers."""

LONGEST_NOTE = 4096
"""Maximum size in bytes of a note of a proxy rule."""

_LONGEST_CUT_NOTE = 600
"""If an encoded note is longer than `LONGEST_NOTE`, the relay keeps only this many characters of its text.
In the encoded note, which is JSON, a character takes at most six bytes.
"""

SPARE_DESCRIPTORS = 4
"""Number of spare file descriptors for clients that send a stop when no other descriptor is free. A UDP
client needs one descriptor. A TCP client needs one descriptor, and two after its first complete frame.
"""


class Relay(DescriptorWatcher):
    """Moves bytes between clients and controllers.

    Attributes:
        counts: Counters in the ring, indexed by `RelayCounter`.
        sessions: Open sessions by client number.
        buffer: Receive buffer for all streams.
        now: Time of a monotonic clock in ns, updated about every `POLL_INTERVAL`.
    """

    def __init__(self, ring: RingWriter, policy: RulePolicy | None = None) -> None:
        super().__init__()
        self.ring = ring
        self.counts = ring.counts
        self.policy = policy
        self.sessions: dict[int, RelaySession] = {}
        self.buffer = bytearray(1 << 16)
        self.now = time.monotonic_ns()
        self.slots = {transport: ClientSlots() for transport in Transport}
        self.pending_connections = PendingConnections(self)
        self._denied = 0
        self._listeners: list[ClientListener] = []
        self._idle: Callable[[], None] = lambda: None
        self._tick_count = 0
        self._next_tick = 0.0
        self._ticker = open_ticker(POLL_INTERVAL)
        if self._ticker is not None:
            self.watch(self._ticker, self._on_ticker)
        self._is_stopped = self._is_closed = False
        self._removed_clients: list[tuple[int, bytes, int]] = []
        self.spares = SpareDescriptors(SPARE_DESCRIPTORS)
        self._undecided: dict[PolicyDecision, _Arrival] = {}
        self._paused_sessions: dict[int, RelaySession] = {}

    def listen(self, listeners: Iterable[ClientListener]) -> None:
        self.spares.refill()
        for listener in listeners:
            self._listeners.append(listener)
            listener.open()

    def stop(self) -> None:
        """Make `run` return soon."""
        self._is_stopped = True

    def run(self, idle: Callable[[], None] = lambda: None) -> None:
        """Forward traffic until `stop` is called. `idle`, called every `POLL_INTERVAL`, must not block."""
        self._is_stopped, self._idle = False, idle
        handler_of, poll, policy = self._handlers.get, self._poller.poll, self.policy
        patience = POLL_INTERVAL if self._ticker is None else None
        while not self._is_stopped:
            for descriptor, happened in poll(patience) if policy is None else self._wait(policy):
                handler = handler_of(descriptor)
                if handler is not None:
                    handler(happened)
            if self._just_unwatched:
                self._adopt_new_handlers()
            if policy is not None:
                self._perform_due(policy)
            if patience is not None and time.monotonic() >= self._next_tick:
                self._next_tick = time.monotonic() + POLL_INTERVAL
                self._tick()

    def release_all_held(self) -> None:
        """When the proxy ends, send the held messages that the proxy's rules release."""
        for session in list(self.sessions.values()):
            self.release_held(session)

    def close(self) -> None:
        self.close_listeners()
        for session in list(self.sessions.values()):
            session.close(False, Message("client.proxy-ended"))
        self._record_removed_clients()
        for listener in self._listeners:
            listener.release()
        self.spares.close()
        if self._ticker is not None:
            os.close(self._ticker)
            self._ticker = None
        self._handlers.clear()
        self._poller.close()

    def close_listeners(self) -> None:
        """Stop accepting clients, and stop receiving datagrams from UDP clients."""
        if not self._is_closed:
            self._is_closed = True
            self.pending_connections.close()
            for listener in self._listeners:
                listener.close()

    def deny(self, client: Endpoint, why: Message, is_datagram: bool = False) -> None:
        """Count a rejected client. Report only the 1st, 2nd, 4th, 8th rejected client and so on."""
        self.counts[RelayCounter.DENIED] += 1
        self._denied += 1
        if should_report(self._denied):
            case = "client.denied.datagrams" if is_datagram else "client.denied.connection"
            self.notify(Message(case, client=str(client), reason=why))

    def free_descriptor(self, *, is_admitted: bool = True) -> bool:
        """Release a spare file descriptor, or disconnect a client. Return whether a descriptor is now free.
        `is_admitted` is False for a TCP client that has not sent its first frame.
        """
        return (
            (not is_admitted and self.spares.release_one(keep=1))
            or self.pending_connections.drop_lowest_priority()
            or self.spares.release_one()
            or any(slots.end_oldest_stop() for slots in self.slots.values())
        )

    def add_client(self, session: RelaySession, ends: ClientEndpoints, received_at: int) -> None:
        """Register a client, whose first bytes arrived at `received_at` in ns since 1970."""
        self.counts[RelayCounter.CLIENTS] += 1
        self.sessions[session.number] = session
        if ends.transport is Transport.TCP:
            self.ring.streams.add(session.number)
        self.ring.write_required(RingRecordKind.CLIENT_OPENED, session.number, ends.to_json(), received_at)
        if self.policy is not None:
            self.policy.add_client(session.number, session.conversation, time.monotonic_ns())

    def remove_client(self, session: RelaySession, why: Message) -> None:
        """Drop the data of a client. The next tick writes `CLIENT_CLOSED`, after the client's last data."""
        self._paused_sessions.pop(session.number, None)
        if self.sessions.pop(session.number, None) is not None:
            self.slots[session.conversation.transport].release(session.number)
            self.record_undecided(session, True)
            self.record_undecided(session, False)
            self._removed_clients.append((session.number, encode_note(why), time.time_ns()))
            if self.policy is not None:
                self.policy.remove_client(session.number, time.monotonic_ns())

    def notify(self, message: Message) -> None:
        self.ring.write_required(RingRecordKind.NOTICE, 0, encode_message(message), time.time_ns())

    def apply_rules(self, session: RelaySession, up: bool, data: bytes, received_at: int) -> None:
        assert self.policy is not None
        decision = self.policy.receive(session.number, direction_of(up), data, time.monotonic_ns())
        if decision.waiting:
            self._undecided[decision] = _Arrival(session, up, data, received_at)
            self._perform(decision.actions)
        else:
            # first write the data that still waits, so that the records of this direction stay in order
            self.record_undecided(session, up)
            self._record_and_perform(session, up, data, received_at, decision)

    def record_undecided(self, session: RelaySession, up: bool) -> None:
        """If data of one session and direction waits for the scripts, record the data."""
        for decision, each in list(self._undecided.items()) if self._undecided else ():
            if each.session is session and each.up is up:
                del self._undecided[decision]
                self.ring.write_record(up, session.number, each.received_at, 0, each.data)

    def _record_and_perform(
        self, session: RelaySession, up: bool, data: bytes, received_at: int, decision: PolicyDecision
    ) -> None:
        if not decision.notes and decision.actions == [SendAction(session.number, direction_of(up), data)]:
            sent_at = session.send(up, data)
            self.ring.write_record(up, session.number, received_at, sent_at, data)
            return
        # `notes` is empty if no proxy rule changed the data
        self.counts[RelayCounter.RULED] += bool(decision.notes)
        self.ring.write_record(up, session.number, received_at, 0, data, note=encode_note(decision.note))
        self._perform(decision.actions)

    def on_stream_end(self, session: RelaySession, up: bool) -> bool:
        """Report the end of a stream to the rules. Return whether the session may forward the FIN now."""
        if self.policy is None:
            return True
        self._perform(self.policy.on_stream_end(session.number, direction_of(up), time.monotonic_ns()))
        return not self.holds(session, up)

    def holds(self, session: RelaySession, up: bool) -> bool:
        """Return whether the session must not forward a FIN yet, because the proxy holds data."""
        return self.policy is not None and self.policy.holds(session.number, direction_of(up))

    def hides_end(self, session: RelaySession) -> bool:
        """Return whether a half-open fault hides every FIN and RST of the session."""
        return self.policy is not None and self.policy.hides_end(session.number)

    def pauses_reading(self, session: RelaySession) -> bool:
        """Return True if the proxy holds so much data that the session must not read more before `resume`."""
        if self.policy is None or not self.policy.is_full(session.number):
            return False
        self._paused_sessions[session.number] = session
        return True

    def release_held(self, session: RelaySession) -> bool:
        """Before a client is disconnected, send the held messages that the rules release. Return whether
        there were any.
        """
        if self.policy is None or session.number not in self.sessions:
            return False
        actions = self.policy.release_held(session.number, time.monotonic_ns())
        self._perform(actions)
        return bool(actions)

    def _perform(self, actions: Sequence[PolicyAction]) -> None:
        for action in actions:
            session = self.sessions.get(action.client)
            if session is None:
                continue
            if isinstance(action, PolicyDecision):
                arrival = self._undecided.pop(action, None)
                if arrival is None:  # `record_undecided` has already written the data to the ring
                    self.counts[RelayCounter.RULED] += bool(action.notes)
                    self._perform(action.actions)
                else:
                    self._record_and_perform(*arrival, action)
            elif isinstance(action, SendAction):
                up = action.toward is Direction.REQUEST
                sent_at = session.send(up, action.data)
                if sent_at:
                    self.ring.write_record(
                        up, session.number, 0, sent_at, action.data, note=encode_note(action.note)
                    )
            else:
                client = str(session.conversation.client)
                self.notify(Message("client.message", client=client, message=action.note))
                session.close(action.reset, action.note)

    def _wait(self, policy: RulePolicy) -> Sequence[tuple[int, int]]:
        due = policy.due()
        if due is None:
            return self._poller.poll(POLL_INTERVAL)
        seconds = (due - time.monotonic_ns()) / 1e9
        return wait_precisely(self._poller, min(max(seconds, 0.0), POLL_INTERVAL))

    def _perform_due(self, policy: RulePolicy) -> None:
        due, now = policy.due(), time.monotonic_ns()
        if due is not None and due <= now:
            actions = policy.pop_due_actions(now)
            self._perform(actions)
            for number in {action.client for action in actions}:
                if (session := self.sessions.get(number)) is not None:
                    session.resume()
        for number, session in list(self._paused_sessions.items()) if self._paused_sessions else ():
            if not policy.is_full(number):
                del self._paused_sessions[number]
                session.resume()

    def _on_ticker(self, _: int) -> None:
        assert self._ticker is not None
        os.read(self._ticker, 8)
        self._tick()

    def _record_removed_clients(self) -> None:
        removed, self._removed_clients = self._removed_clients, []
        for number, why, when in removed:
            self.ring.write_required(RingRecordKind.CLIENT_CLOSED, number, why, when)
            self.ring.streams.discard(number)

    def _tick(self) -> None:
        self.ring.flush()
        self._record_removed_clients()
        self._idle()
        self._tick_count += 1
        if self._tick_count % SWEEP_EVERY == 0:
            self._sweep()
        # Update `now` last: otherwise, `_sweep` after a long pause would remove clients with unread data.
        self.now = time.monotonic_ns()

    def _sweep(self) -> None:
        self._resume_paused()
        self.spares.refill()
        self.pending_connections.sweep(self.now)
        for listener in self._listeners:
            listener.sweep(self.now)
        for session in list(self.sessions.values()):
            session.sweep(self.now)


class _Arrival(NamedTuple):
    session: RelaySession
    up: bool
    data: bytes
    received_at: int


def encode_note(note: Message | None) -> bytes:
    """Encode a note for the ring; b"" for None. Of a long note, keep only the start of its English text."""
    if note is None:
        return b""
    data = encode_message(note)
    return data if len(data) <= LONGEST_NOTE else encode_message(foreign_text(str(note)[:_LONGEST_CUT_NOTE]))


def direction_of(up: bool) -> Direction:
    return Direction.REQUEST if up else Direction.RESPONSE
