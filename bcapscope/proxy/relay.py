"""The relay: one thread that moves bytes between clients and controllers and looks at none of them.

What passed goes into a ring that another process watches. Only where there are rules are they asked first.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from bcapscope.proxy.admission import ClientSlots
from bcapscope.proxy.pending_connections import PendingConnections
from bcapscope.proxy.policy import CloseAction, LateDecision, Policy, PolicyAction, SendAction
from bcapscope.proxy.poller import READ, make_poller, open_ticker, wait_precisely
from bcapscope.proxy.ring_buffer import RelayCounter, RingRecordKind, RingWriter
from bcapscope.proxy.sockets import should_report
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Transport
from bcapscope.transport.descriptors import SpareDescriptors

Address: TypeAlias = tuple[str, int]
Handler: TypeAlias = Callable[[int], None]
"""Is called with what happened to a file descriptor."""

POLL_INTERVAL = 0.05
"""Seconds that it waits at most: what passed is told after that, and an order to end is noticed."""

_SWEEP_EVERY = 20
"""So many times that makes one look at what does not come by itself: silent clients, full buffers."""

_LONGEST_NOTE = 4096
"""Bytes."""

_SPARE_DESCRIPTORS = 4
"""File descriptors for stops when there are no others: two for a TCP client, one for a UDP client, and one
for a client that has not said yet what it wants."""


class RelaySession(Protocol):
    """One client's way to its controller.

    Attributes:
        number: of the client, never used twice.
        conversation: between the client and the controller itself.
        source: where the client comes from; see `source_network`.
        last_heard: `Relay.now` when it was last heard.
    """

    number: int
    conversation: Conversation
    source: str
    last_heard: int

    @property
    def upstream_state(self) -> str:
        """How the way to the controller is: open, connecting, connected, half-open, refused."""

    def send(self, up: bool, data: bytes) -> int:
        """Send, to the controller or to the client; return when, 0 if not all of it went out yet."""

    def on_nothing_held(self, up: bool) -> None:
        """Take notice that nothing of a direction is held back any more."""

    def resume_reading(self) -> None:
        """Read what was not read while rules held too much."""

    def evictable_idle_ns(self, now: int) -> int | None:
        """Return the ns for which it has done nothing, if it may give its place to another; else None."""

    def close(self, reset: bool, why: str) -> None:
        """Let go."""

    def sweep(self, now: int) -> None:
        """Do what is due from time to time; `now` as `Relay.now`."""


class ClientListener(Protocol):
    """A socket that clients come to."""

    def open(self) -> None:
        """Begin to take clients."""

    def close(self) -> None:
        """Take no more clients."""

    def release(self) -> None:
        """Let go of the socket; `close` came before, and no session is left."""

    def sweep(self, now: int) -> None:
        """Do what is to be done from time to time; `now` as `Relay.now`."""


class Relay:
    """Moves bytes.

    Attributes:
        ring: the traffic, for the watching process.
        counts: of the ring.
        policy: the rules; None without.
        sessions: those that are open, by number.
        slots: which of them are clients, and who may become one, by transport.
        pending_connections: TCP clients that have not sent a complete frame yet.
        spares: file descriptors held back for stops.
        buffer: for receiving; one thread needs one.
        now: ns of a clock that does not go back, as it was some `POLL_INTERVAL` ago at most.
    """

    def __init__(self, ring: RingWriter, policy: Policy | None = None) -> None:
        """Begin without listeners."""
        self.ring = ring
        self.counts = ring.counts
        self.policy = policy
        self.sessions: dict[int, RelaySession] = {}
        self.buffer = bytearray(1 << 16)
        self.now = time.monotonic_ns()
        self.slots = {transport: ClientSlots() for transport in Transport}
        self.pending_connections = PendingConnections(self)
        self._denied = 0
        self._poller = make_poller()
        self._handlers: dict[int, Handler] = {}
        self._new_handlers: dict[int, Handler] = {}
        self._just_unwatched: set[int] = set()
        self._paused: set[int] = set()
        self._listeners: list[ClientListener] = []
        self._idle: Callable[[], None] = lambda: None
        self._tick_count = 0
        self._next_tick = 0.0
        self._ticker = open_ticker(POLL_INTERVAL)
        if self._ticker is not None:
            self.watch(self._ticker, self._on_ticker)
        self._is_stopped = self._is_closed = False
        self._removed_clients: list[tuple[int, bytes, int]] = []
        self.spares = SpareDescriptors(_SPARE_DESCRIPTORS)
        self._undecided: dict[int, _Arrival] = {}
        self._paused_sessions: dict[int, RelaySession] = {}

    def listen(self, listeners: Iterable[ClientListener]) -> None:
        """Take clients from these ports."""
        self.spares.refill()
        for port in listeners:
            self._listeners.append(port)
            port.open()

    def stop(self) -> None:
        """End `run` soon; from a signal handler or from what it calls."""
        self._is_stopped = True

    def run(self, idle: Callable[[], None] = lambda: None) -> None:
        """Move bytes until stopped.

        Args:
            idle: called some twenty times a second; it must not wait.
        """
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
        """Send what rules still give out of what they hold, as all is about to end."""
        for session in list(self.sessions.values()):
            self.release_held(session)

    def close(self) -> None:
        """Let go of all clients and ports."""
        self.close_listeners()
        for session in list(self.sessions.values()):
            session.close(False, "the proxy ended")
        self._record_removed_clients()
        for port in self._listeners:
            port.release()
        self.spares.close()
        if self._ticker is not None:
            os.close(self._ticker)
            self._ticker = None
        self._handlers.clear()
        self._poller.close()

    def close_listeners(self) -> None:
        """Take no more clients, and nothing more from those of UDP."""
        if not self._is_closed:
            self._is_closed = True
            self.pending_connections.close()
            for port in self._listeners:
                port.close()

    # For ports and sessions.

    def watch(self, descriptor: int, handler: Handler, mask: int = READ) -> None:
        """Call `handler` whenever something happens to a file descriptor.

        One whose number was another's a moment ago is called for what happens from the next look on: what the
        poller has told already happened to the other.
        """
        handlers = self._new_handlers if descriptor in self._just_unwatched else self._handlers
        handlers[descriptor] = handler
        self._poller.register(descriptor, mask)

    def change(self, descriptor: int, mask: int) -> None:
        """Wait for something else of a file descriptor."""
        self._poller.modify(descriptor, mask)

    def unwatch(self, descriptor: int) -> None:
        """Forget a file descriptor."""
        if self._handlers.pop(descriptor, None) or self._new_handlers.pop(descriptor, None):
            self._just_unwatched.add(descriptor)
            self._paused.discard(descriptor)
            self._poller.unregister(descriptor)

    def pause(self, descriptor: int) -> None:
        """Wait for nothing of a file descriptor for about a second, as nothing can be done about it now."""
        self._poller.modify(descriptor, 0)
        self._paused.add(descriptor)

    def deny(self, client: Endpoint, why: str, what: str = "its connection is closed") -> None:
        """Count a client that gets no place; tell the user of the 1st, 2nd, 4th, 8th … of them."""
        self.counts[RelayCounter.DENIED] += 1
        self._denied += 1
        if should_report(self._denied):
            self.notify(f"{client} {why}; {what}")

    def free_newcomer_descriptor(self) -> bool:
        """Free a file descriptor for a TCP client that may yet send a stop; return whether there was one."""
        return (
            self.spares.release_one(keep=1)
            or self.pending_connections.drop_lowest_priority()
            or self.spares.release_one()
            or self._end_oldest_stop()
        )

    def free_descriptor(self) -> bool:
        """Free a file descriptor for a client that must get in; return whether there was one to free."""
        return (
            self.pending_connections.drop_lowest_priority()
            or self.spares.release_one()
            or self._end_oldest_stop()
        )

    def _end_oldest_stop(self) -> bool:
        return any(places.end_oldest_stop() for places in self.slots.values())

    def add_client(self, session: RelaySession, ends: Sequence[Endpoint], received_at: int) -> None:
        """Take in a new client.

        Args:
            session: its way to the controller.
            ends: the client, where it came to, our end towards the controller, and the controller.
            received_at: its first bytes came, ns since 1970.
        """
        self.counts[RelayCounter.CLIENTS] += 1
        self.sessions[session.number] = session
        if session.conversation.transport is Transport.TCP:
            self.ring.streams.add(session.number)
        told = json.dumps([session.conversation.transport, *ends]).encode()
        self.ring.write_required(RingRecordKind.CLIENT_OPENED, session.number, told, received_at)
        if self.policy is not None:
            self.policy.add_client(session.number, session.conversation, time.monotonic_ns())

    def next_number(self) -> int:
        """Return the number of the next client."""
        return self.counts[RelayCounter.CLIENTS] + 1

    def remove_client(self, session: RelaySession, why: str) -> None:
        """Forget a client; that is told soon, behind what came of it and could not be passed on any more."""
        self._paused_sessions.pop(session.number, None)
        if self.sessions.pop(session.number, None) is not None:
            self.slots[session.conversation.transport].release(session.number)
            self.record_undecided(session, True)
            self.record_undecided(session, False)
            self._removed_clients.append((session.number, _encode_note(why), time.time_ns()))
            if self.policy is not None:
                self.policy.remove_client(session.number, time.monotonic_ns())

    def notify(self, text: str) -> None:
        """Tell the user something."""
        self.ring.write_required(RingRecordKind.NOTICE, 0, text.encode("utf-8", "replace"), time.time_ns())

    def apply_rules(self, session: RelaySession, up: bool, data: bytes, received_at: int) -> None:
        """Ask the rules what becomes of something that came, and do it."""
        assert self.policy is not None
        decision = self.policy.receive(session.number, direction_of(up), data, time.monotonic_ns())
        arrival = _Arrival(session, up, data, received_at)
        if decision.ticket:
            self._undecided[decision.ticket] = arrival
            self._perform(decision.actions)
        else:
            self.record_undecided(session, up)  # that came before
            self._record_and_perform(arrival, decision.note, decision.actions)

    def record_undecided(self, session: RelaySession, up: bool) -> None:
        """Record what came in a direction and still waits, so that later notes come after it."""
        for ticket, each in list(self._undecided.items()) if self._undecided else ():
            if each.session is session and each.up is up:
                del self._undecided[ticket]
                self.ring.write_record(up, session.number, each.received_at, 0, each.data)

    def _record_and_perform(
        self, arrival: _Arrival, note: str, actions: Sequence[SendAction | CloseAction]
    ) -> None:
        """Record something that came, and do what was decided about it."""
        session, up, data, came = arrival
        if not note and len(actions) == 1:
            action = actions[0]
            if action == SendAction(session.number, direction_of(up), data):
                left = session.send(up, data)
                self.ring.write_record(up, session.number, came, left, data)
                return
        self.counts[RelayCounter.RULED] += bool(note)  # what is only cut into frames is touched by none
        self.ring.write_record(up, session.number, came, 0, data, note=_encode_note(note))
        self._perform(actions)

    def on_stream_end(self, session: RelaySession, up: bool) -> bool:
        """Tell the rules that a stream has ended in one direction; tell whether its end may be passed on."""
        if self.policy is None:
            return True
        self._perform(self.policy.on_stream_end(session.number, direction_of(up), time.monotonic_ns()))
        return not self.holds(session, up)

    def holds(self, session: RelaySession, up: bool) -> bool:
        """Tell whether rules hold something of a direction, so that its end may not be passed on yet."""
        return self.policy is not None and self.policy.holds(session.number, direction_of(up))

    def hides_end(self, session: RelaySession) -> bool:
        """Tell whether neither side of a client may hear of the other's end."""
        return self.policy is not None and self.policy.hides_end(session.number)

    def pauses_reading(self, session: RelaySession) -> bool:
        """Tell whether rules hold so much that a stream is not to be read; it hears when that has changed."""
        if self.policy is None or not self.policy.is_full(session.number):
            return False
        self._paused_sessions[session.number] = session
        return True

    def release_held(self, session: RelaySession) -> bool:
        """Send what rules give out of what they hold of a client that is about to end; tell if it was any."""
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
            if isinstance(action, LateDecision):
                arrival = self._undecided.pop(action.ticket, None)
                if arrival is None:  # it is noted, without what became of it
                    self.counts[RelayCounter.RULED] += bool(action.note)
                    self._perform(action.actions)
                else:
                    self._record_and_perform(arrival, action.note, action.actions)
            elif isinstance(action, SendAction):
                up = action.toward is Direction.REQUEST
                left = session.send(up, action.data)
                if left:
                    self.ring.write_record(
                        up, session.number, 0, left, action.data, note=_encode_note(action.note)
                    )
            else:
                self.notify(f"{session.conversation.client}: {action.note}")
                session.close(action.reset, action.note)

    def _wait(self, policy: Policy) -> Sequence[tuple[int, int]]:
        due = policy.due()
        if due is None:
            return self._poller.poll(POLL_INTERVAL)
        seconds = (due - time.monotonic_ns()) / 1e9
        return wait_precisely(self._poller, min(max(seconds, 0.0), POLL_INTERVAL))

    def _perform_due(self, policy: Policy) -> None:
        due, now = policy.due(), time.monotonic_ns()
        if due is not None and due <= now:
            actions = policy.pop_due_actions(now)
            self._perform(actions)
            for number in {action.client for action in actions}:
                session = self.sessions.get(number)
                for up in (True, False) if session is not None else ():
                    if session is not None and not policy.holds(number, direction_of(up)):
                        session.on_nothing_held(up)
        for number, session in list(self._paused_sessions.items()) if self._paused_sessions else ():
            if not policy.is_full(number):
                del self._paused_sessions[number]
                session.resume_reading()

    def _on_ticker(self, _: int) -> None:
        assert self._ticker is not None
        os.read(self._ticker, 8)
        self._tick()

    def _record_removed_clients(self) -> None:
        parted, self._removed_clients = self._removed_clients, []
        for number, why, when in parted:
            self.ring.write_required(RingRecordKind.CLIENT_CLOSED, number, why, when)
            self.ring.streams.discard(number)

    def _tick(self) -> None:
        """Write what is noted; from time to time do what does not come by itself."""
        self.ring.flush()
        self._record_removed_clients()
        self._idle()
        self._tick_count += 1
        if self._tick_count % _SWEEP_EVERY == 0:
            self._sweep()
        # Not earlier: if nothing ran for long, what came meanwhile is heard before anybody is called silent.
        self.now = time.monotonic_ns()

    def _sweep(self) -> None:
        while self._paused:
            self._poller.modify(self._paused.pop(), READ)
        self.spares.refill()
        self.pending_connections.sweep(self.now)
        for port in self._listeners:
            port.sweep(self.now)
        for session in list(self.sessions.values()):
            session.sweep(self.now)

    def _adopt_new_handlers(self) -> None:
        """Forget which file descriptors were left during a look, and begin with those that came instead."""
        self._just_unwatched.clear()
        self._handlers.update(self._new_handlers)
        self._new_handlers.clear()


class _Arrival(NamedTuple):
    """Something that came; `received_at` is when, ns since 1970."""

    session: RelaySession
    up: bool
    data: bytes
    received_at: int


def _encode_note(note: str) -> bytes:
    """Encode words for the ring; the name of a fault may have half characters in it, if it was typed so."""
    return note.encode("utf-8", "replace")[:_LONGEST_NOTE]


def direction_of(up: bool) -> Direction:
    """Return whether that is what clients or what controllers say."""
    return Direction.REQUEST if up else Direction.RESPONSE


def client_conversation(client: Endpoint, controller: Endpoint, transport: Transport) -> Conversation:
    """Make the conversation of a client that came to a proxy."""
    return Conversation(client, controller, transport, "the proxy")
