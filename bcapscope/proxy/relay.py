"""The relay: one thread that moves bytes between clients and controllers and looks at none of them.

What passed goes into a ring that another process watches. Only where there are rules are they asked first.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from bcapscope.proxy.admission import Places
from bcapscope.proxy.entrance import Entrance
from bcapscope.proxy.hook import Action, Close, LateDecision, Policy, Send
from bcapscope.proxy.poller import READ, make_poller, open_ticker, wait_precisely
from bcapscope.proxy.ring import Count, Kind, RingWriter
from bcapscope.proxy.sockets import is_told
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Transport
from bcapscope.transport.descriptors import SpareDescriptors

Address: TypeAlias = tuple[str, int]
Handler: TypeAlias = Callable[[int], None]
"""Is called with what happened to a file descriptor."""

PATIENCE = 0.05
"""Seconds that it waits at most: what passed is told after that, and an order to end is noticed."""

_SWEEP_EVERY = 20
"""So many times that makes one look at what does not come by itself: silent clients, full buffers."""

_LONGEST_NOTE = 4096
"""Bytes."""

_SPARE_DESCRIPTORS = 4
"""File descriptors for stops when there are no others: two for a TCP client, one for a UDP client, and one
for a client that has not said yet what it wants."""


class Session(Protocol):
    """One client's way to its controller.

    Attributes:
        number: of the client, never used twice.
        conversation: between the client and the controller itself.
        source: where the client comes from; see `source_of`.
        heard: `Relay.now` when it was last heard.
    """

    number: int
    conversation: Conversation
    source: str
    heard: int

    @property
    def state(self) -> str:
        """How the way to the controller is: open, connecting, connected, half-open, refused."""

    def send(self, up: bool, data: bytes) -> int:
        """Send, to the controller or to the client; return when, 0 if not all of it went out yet."""

    def passed_on(self, up: bool) -> None:
        """Take notice that nothing of a direction is held back any more."""

    def read_on(self) -> None:
        """Read what was not read while rules held too much."""

    def quiet(self, now: int) -> int | None:
        """Return the ns for which it has done nothing, if it may give its place to another; else None."""

    def close(self, reset: bool, why: str) -> None:
        """Let go."""

    def sweep(self, now: int) -> None:
        """Do what is due from time to time; `now` as `Relay.now`."""


class Port(Protocol):
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
        places: which of them are clients, and who may become one, by transport.
        entrance: TCP clients that have not sent a complete frame yet.
        spares: file descriptors held back for stops.
        buffer: for receiving; one thread needs one.
        now: ns of a clock that does not go back, as it was some `PATIENCE` ago at most.
    """

    def __init__(self, ring: RingWriter, policy: Policy | None = None) -> None:
        """Begin without listeners."""
        self.ring = ring
        self.counts = ring.counts
        self.policy = policy
        self.sessions: dict[int, Session] = {}
        self.buffer = bytearray(1 << 16)
        self.now = time.monotonic_ns()
        self.places = {transport: Places() for transport in Transport}
        self.entrance = Entrance(self)
        self._denied = 0
        self._poller = make_poller()
        self._handlers: dict[int, Handler] = {}
        self._coming: dict[int, Handler] = {}
        self._left: set[int] = set()
        self._paused: set[int] = set()
        self._ports: list[Port] = []
        self._idle: Callable[[], None] = lambda: None
        self._beats = 0
        self._next_beat = 0.0
        self._ticker = open_ticker(PATIENCE)
        if self._ticker is not None:
            self.watch(self._ticker, self._ticked)
        self._stopped = self._closed = False
        self._parted: list[tuple[int, bytes, int]] = []
        self.spares = SpareDescriptors(_SPARE_DESCRIPTORS)
        self._undecided: dict[int, _Arrival] = {}
        self._unread: dict[int, Session] = {}

    def listen(self, ports: Iterable[Port]) -> None:
        """Take clients from these ports."""
        self.spares.fill()
        for port in ports:
            self._ports.append(port)
            port.open()

    def stop(self) -> None:
        """End `run` soon; from a signal handler or from what it calls."""
        self._stopped = True

    def run(self, idle: Callable[[], None] = lambda: None) -> None:
        """Move bytes until stopped.

        Args:
            idle: called some twenty times a second; it must not wait.
        """
        self._stopped, self._idle = False, idle
        handler_of, poll, policy = self._handlers.get, self._poller.poll, self.policy
        patience = PATIENCE if self._ticker is None else None
        while not self._stopped:
            for descriptor, happened in poll(patience) if policy is None else self._wait(policy):
                handler = handler_of(descriptor)
                if handler is not None:
                    handler(happened)
            if self._left:
                self._admit()
            if policy is not None:
                self._take_due(policy)
            if patience is not None and time.monotonic() >= self._next_beat:
                self._next_beat = time.monotonic() + PATIENCE
                self._beat()

    def let_all_go(self) -> None:
        """Send what rules still give out of what they hold, as all is about to end."""
        for session in list(self.sessions.values()):
            self.let_go(session)

    def close(self) -> None:
        """Let go of all clients and ports."""
        self.close_ports()
        for session in list(self.sessions.values()):
            session.close(False, "the proxy ended")
        self._tell_parted()
        for port in self._ports:
            port.release()
        self.spares.close()
        if self._ticker is not None:
            os.close(self._ticker)
            self._ticker = None
        self._handlers.clear()
        self._poller.close()

    def close_ports(self) -> None:
        """Take no more clients, and nothing more from those of UDP."""
        if not self._closed:
            self._closed = True
            self.entrance.close()
            for port in self._ports:
                port.close()

    # For ports and sessions.

    def watch(self, descriptor: int, handler: Handler, mask: int = READ) -> None:
        """Call `handler` whenever something happens to a file descriptor.

        One whose number was another's a moment ago is called for what happens from the next look on: what the
        poller has told already happened to the other.
        """
        handlers = self._coming if descriptor in self._left else self._handlers
        handlers[descriptor] = handler
        self._poller.register(descriptor, mask)

    def change(self, descriptor: int, mask: int) -> None:
        """Wait for something else of a file descriptor."""
        self._poller.modify(descriptor, mask)

    def unwatch(self, descriptor: int) -> None:
        """Forget a file descriptor."""
        if self._handlers.pop(descriptor, None) or self._coming.pop(descriptor, None):
            self._left.add(descriptor)
            self._paused.discard(descriptor)
            self._poller.unregister(descriptor)

    def pause(self, descriptor: int) -> None:
        """Wait for nothing of a file descriptor for about a second, as nothing can be done about it now."""
        self._poller.modify(descriptor, 0)
        self._paused.add(descriptor)

    def deny(self, client: Endpoint, why: str, what: str = "its connection is closed") -> None:
        """Count a client that gets no place; tell the user of the 1st, 2nd, 4th, 8th … of them."""
        self.counts[Count.DENIED] += 1
        self._denied += 1
        if is_told(self._denied):
            self.tell(f"{client} {why}; {what}")

    def free_for_newcomer(self) -> bool:
        """Free a file descriptor for a TCP client that may yet send a stop; return whether there was one."""
        return (
            self.spares.give(keep=1) or self.entrance.drop() or self.spares.give() or self._end_oldest_stop()
        )

    def free_descriptor(self) -> bool:
        """Free a file descriptor for a client that must get in; return whether there was one to free."""
        return self.entrance.drop() or self.spares.give() or self._end_oldest_stop()

    def _end_oldest_stop(self) -> bool:
        return any(places.end_oldest_stop() for places in self.places.values())

    def meet(self, session: Session, ends: Sequence[Endpoint], when: int) -> None:
        """Take in a new client.

        Args:
            session: its way to the controller.
            ends: the client, where it came to, our end towards the controller, and the controller.
            when: its first bytes came, ns since 1970.
        """
        self.counts[Count.CLIENTS] += 1
        self.sessions[session.number] = session
        if session.conversation.transport is Transport.TCP:
            self.ring.streams.add(session.number)
        told = json.dumps([session.conversation.transport, *ends]).encode()
        self.ring.must(Kind.OPENED, session.number, told, when)
        if self.policy is not None:
            self.policy.opened(session.number, session.conversation, time.monotonic_ns())

    def next_number(self) -> int:
        """Return the number of the next client."""
        return self.counts[Count.CLIENTS] + 1

    def part(self, session: Session, why: str) -> None:
        """Forget a client; that is told soon, behind what came of it and could not be passed on any more."""
        self._unread.pop(session.number, None)
        if self.sessions.pop(session.number, None) is not None:
            self.places[session.conversation.transport].leave(session.number)
            self.note_undecided(session, True)
            self.note_undecided(session, False)
            self._parted.append((session.number, _encoded(why), time.time_ns()))
            if self.policy is not None:
                self.policy.gone(session.number, time.monotonic_ns())

    def tell(self, text: str) -> None:
        """Tell the user something."""
        self.ring.must(Kind.TOLD, 0, text.encode("utf-8", "replace"), time.time_ns())

    def rule(self, session: Session, up: bool, data: bytes, came: int) -> None:
        """Ask the rules what becomes of something that came, and do it."""
        assert self.policy is not None
        decision = self.policy.receive(session.number, direction_of(up), data, time.monotonic_ns())
        arrival = _Arrival(session, up, data, came)
        if decision.ticket:
            self._undecided[decision.ticket] = arrival
            self._perform(decision.actions)
        else:
            self.note_undecided(session, up)  # that came before
            self._settle(arrival, decision.note, decision.actions)

    def note_undecided(self, session: Session, up: bool) -> None:
        """Record what came in a direction and still waits, so that later notes come after it."""
        for ticket, each in list(self._undecided.items()) if self._undecided else ():
            if each.session is session and each.up is up:
                del self._undecided[ticket]
                self.ring.put(up, session.number, each.came, 0, each.data)

    def _settle(self, arrival: _Arrival, note: str, actions: Sequence[Send | Close]) -> None:
        """Record something that came, and do what was decided about it."""
        session, up, data, came = arrival
        if not note and len(actions) == 1:
            action = actions[0]
            if action == Send(session.number, direction_of(up), data):
                left = session.send(up, data)
                self.ring.put(up, session.number, came, left, data)
                return
        self.counts[Count.RULED] += bool(note)  # what is only cut into frames is touched by none
        self.ring.put(up, session.number, came, 0, data, note=_encoded(note))
        self._perform(actions)

    def ends(self, session: Session, up: bool) -> bool:
        """Tell the rules that a stream has ended in one direction; tell whether its end may be passed on."""
        if self.policy is None:
            return True
        self._perform(self.policy.ended(session.number, direction_of(up), time.monotonic_ns()))
        return not self.holds(session, up)

    def holds(self, session: Session, up: bool) -> bool:
        """Tell whether rules hold something of a direction, so that its end may not be passed on yet."""
        return self.policy is not None and self.policy.holds(session.number, direction_of(up))

    def hides_end(self, session: Session) -> bool:
        """Tell whether neither side of a client may hear of the other's end."""
        return self.policy is not None and self.policy.hides_end(session.number)

    def is_full(self, session: Session) -> bool:
        """Tell whether rules hold so much that a stream is not to be read; it hears when that has changed."""
        if self.policy is None or not self.policy.is_full(session.number):
            return False
        self._unread[session.number] = session
        return True

    def let_go(self, session: Session) -> bool:
        """Send what rules give out of what they hold of a client that is about to end; tell if it was any."""
        if self.policy is None or session.number not in self.sessions:
            return False
        actions = self.policy.let_go(session.number, time.monotonic_ns())
        self._perform(actions)
        return bool(actions)

    def _perform(self, actions: Sequence[Action]) -> None:
        for action in actions:
            session = self.sessions.get(action.client)
            if session is None:
                continue
            if isinstance(action, LateDecision):
                arrival = self._undecided.pop(action.ticket, None)
                if arrival is None:  # it is noted, without what became of it
                    self.counts[Count.RULED] += bool(action.note)
                    self._perform(action.actions)
                else:
                    self._settle(arrival, action.note, action.actions)
            elif isinstance(action, Send):
                up = action.toward is Direction.REQUEST
                left = session.send(up, action.data)
                if left:
                    self.ring.put(up, session.number, 0, left, action.data, note=_encoded(action.note))
            else:
                self.tell(f"{session.conversation.client}: {action.note}")
                session.close(action.reset, action.note)

    def _wait(self, policy: Policy) -> Sequence[tuple[int, int]]:
        due = policy.due()
        if due is None:
            return self._poller.poll(PATIENCE)
        seconds = (due - time.monotonic_ns()) / 1e9
        return wait_precisely(self._poller, min(max(seconds, 0.0), PATIENCE))

    def _take_due(self, policy: Policy) -> None:
        due, now = policy.due(), time.monotonic_ns()
        if due is not None and due <= now:
            actions = policy.take(now)
            self._perform(actions)
            for number in {action.client for action in actions}:
                session = self.sessions.get(number)
                for up in (True, False) if session is not None else ():
                    if session is not None and not policy.holds(number, direction_of(up)):
                        session.passed_on(up)
        for number, session in list(self._unread.items()) if self._unread else ():
            if not policy.is_full(number):
                del self._unread[number]
                session.read_on()

    def _ticked(self, _: int) -> None:
        assert self._ticker is not None
        os.read(self._ticker, 8)
        self._beat()

    def _tell_parted(self) -> None:
        parted, self._parted = self._parted, []
        for number, why, when in parted:
            self.ring.must(Kind.GONE, number, why, when)
            self.ring.streams.discard(number)

    def _beat(self) -> None:
        """Write what is noted; from time to time do what does not come by itself."""
        self.ring.flush()
        self._tell_parted()
        self._idle()
        self._beats += 1
        if self._beats % _SWEEP_EVERY == 0:
            self._sweep()
        # Not earlier: if nothing ran for long, what came meanwhile is heard before anybody is called silent.
        self.now = time.monotonic_ns()

    def _sweep(self) -> None:
        while self._paused:
            self._poller.modify(self._paused.pop(), READ)
        self.spares.fill()
        self.entrance.sweep(self.now)
        for port in self._ports:
            port.sweep(self.now)
        for session in list(self.sessions.values()):
            session.sweep(self.now)

    def _admit(self) -> None:
        """Forget which file descriptors were left during a look, and begin with those that came instead."""
        self._left.clear()
        self._handlers.update(self._coming)
        self._coming.clear()


class _Arrival(NamedTuple):
    """Something that came; `came` is when, ns since 1970."""

    session: Session
    up: bool
    data: bytes
    came: int


def _encoded(note: str) -> bytes:
    """Encode words for the ring; the name of a fault may have half characters in it, if it was typed so."""
    return note.encode("utf-8", "replace")[:_LONGEST_NOTE]


def direction_of(up: bool) -> Direction:
    """Return whether that is what clients or what controllers say."""
    return Direction.REQUEST if up else Direction.RESPONSE


def conversation(client: Endpoint, controller: Endpoint, transport: Transport) -> Conversation:
    """Make the conversation of a client that came to a proxy."""
    return Conversation(client, controller, transport, "the proxy")
