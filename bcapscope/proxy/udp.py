"""Datagrams: each client gets a socket of its own, so that the controller tells them apart."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from contextlib import suppress

from bcapscope.protocol.hresult import S_EXECUTING
from bcapscope.protocol.opening import begins_with_stop
from bcapscope.proxy.admission import Place
from bcapscope.proxy.relay import Handler, Relay, conversation
from bcapscope.proxy.ring import BATCH, Count
from bcapscope.proxy.sockets import (
    LARGEST,
    SocketAddress,
    connect_datagrams,
    drops,
    endpoint_of,
    facing,
    is_told,
    listen_on,
    reason,
    resolve,
)
from bcapscope.proxy.spec import Listener
from bcapscope.traffic.observation import Transport
from bcapscope.transport.arrival import CONTROL, kernel_time, receiver
from bcapscope.transport.descriptors import NO_DESCRIPTORS, can_be_read, none_left
from bcapscope.transport.lobby import source_of

FORGET_AFTER = 600_000_000_000
"""ns of silence after which a client is forgotten. It would then be another client to the controller, so this
is long; its socket costs nothing."""

GIVE_WAY_AFTER = 10_000_000_000
"""ns of silence after which a client gives its place to a new one if all are taken, as in DENSO's C server
(orin_bcap C/src/bcap_server.c)."""

_MOST_OLD = 10_000
_TRIES = 2
_PATIENCE = 0.3
"""Seconds for the answer to a try."""

_STILL_EXECUTING = S_EXECUTING.to_bytes(4, "little")

_MOST_STRANGERS = 256
"""Addresses that are told to be refused, each once."""


class UdpPort:
    """A socket that clients send to.

    Attributes:
        relay: whose it is.
        address: where it listens.
        controller: address family and address of the controller.
        to: the same as the user says it.
        sender: the socket.
        refused: the user was told that the controller refuses datagrams.
    """

    def __init__(self, relay: Relay, listener: Listener, forget_after: int = FORGET_AFTER) -> None:
        """Listen.

        Raises:
            ListenError: that cannot be done.
        """
        self.relay = relay
        self.controller = resolve(listener.to, Transport.UDP)
        self.sender = listen_on(listener.listen, Transport.UDP)
        self.address = endpoint_of(self.sender.getsockname())
        self.to = endpoint_of(self.controller[1])
        self.refused = False
        self._listener = listener
        self._forget_after = forget_after
        self._sessions: dict[SocketAddress, UdpSession] = {}
        self._fresh: dict[SocketAddress, UdpSession] = {}
        self._strangers: set[str] = set()
        self._dropped = self._wayless = 0

    def open(self) -> None:
        """Begin to take clients; what came before is as if nobody had listened, since it may be old."""
        with suppress(OSError):
            for _ in range(_MOST_OLD):
                self.sender.recv(LARGEST)
        self.relay.watch(
            self.sender.fileno(), self._passing() if self.relay.policy is None else self._ruled()
        )

    def close(self) -> None:
        """Take nothing more; what comes for clients is still sent to them."""
        self._count_drops()
        self.relay.unwatch(self.sender.fileno())

    def release(self) -> None:
        """Close the socket."""
        self.sender.close()

    def sweep(self, now: int) -> None:
        """Forget who was silent for long; count what the system dropped."""
        self._count_drops()
        for session in (*self._sessions.values(), *self._fresh.values()):
            if now - session.heard > self._forget_after:
                session.close(False, f"silent for {self._forget_after // 1_000_000_000} s")

    def forget(self, address: SocketAddress) -> None:
        """Forget a client."""
        self._sessions.pop(address, None)
        self._fresh.pop(address, None)

    def _passing(self) -> Handler:
        """Make what passes datagrams on as they come; all that it needs is at hand, as it runs so often."""
        receive, known, meet = receiver(self.sender), self._sessions.get, self._meet
        relay, ring, now = self.relay, self.relay.ring, time.time_ns
        notes, note, flush = ring.notes, ring.notes.append, ring.flush

        def take(_: int) -> None:
            try:
                data, control, _flags, address = receive(LARGEST, CONTROL)
            except OSError:  # nothing there after all; on Windows an earlier client's closed port
                return
            session = known(address) or meet(address, data)
            if session is None:
                return
            session.heard = relay.now
            left = now()
            try:
                session.send_up(data)
            except OSError as error:
                left = session.send_again(data, error)
            note((True, session.number, control, left, data))
            if len(notes) >= BATCH:
                flush()

        return take

    def _ruled(self) -> Handler:
        """Make what asks the rules first."""
        receive, relay = receiver(self.sender), self.relay

        def take(_: int) -> None:
            try:
                data, control, _flags, address = receive(LARGEST, CONTROL)
            except OSError:
                return
            session = self._sessions.get(address) or self._meet(address, data)
            if session is not None:
                session.heard = relay.now
                relay.counts[Count.CAME_UP] += 1
                relay.rule(session, True, data, kernel_time(control, 0))

        return take

    def _meet(self, address: SocketAddress, data: bytes) -> UdpSession | None:
        """Return the session of a client that was heard once at most; None if it may not have one."""
        session = self._fresh.pop(address, None)
        if session is not None:
            self._sessions[address] = session
            self.relay.places[Transport.UDP].settle(session.number)
            return session
        if not self._listener.allows(address[0]):
            self._turn_away(address)
            return None
        return self._admit(address, begins_with_stop(data))

    def _turn_away(self, address: SocketAddress) -> None:
        relay = self.relay
        relay.counts[Count.DENIED] += 1
        if address[0] not in self._strangers and len(self._strangers) < _MOST_STRANGERS:
            self._strangers.add(address[0])
            relay.tell(f"{endpoint_of(address)} is not allowed; its datagrams are dropped")

    def _admit(self, address: SocketAddress, is_stop: bool) -> UdpSession | None:
        """Give a new client a place and a socket of its own towards the controller."""
        relay = self.relay
        places = relay.places[Transport.UDP]
        place = places.find(address[0], relay.now, is_stop)
        if place is Place.NONE:
            self._refuse(address, "is one client too many")
            return None
        try:
            upstream = self._new_socket(is_stop)
        except OSError as error:
            self._tell_wayless(address, error)
            return None
        if not relay.spares.fill():
            place = Place.KEPT
            if not is_stop:
                upstream.close()
                self._refuse(address, f"cannot be accepted: {NO_DESCRIPTORS}")
                return None
        session = self._fresh[address] = UdpSession(self, address, upstream)
        places.take(session, place, is_fresh=True)
        return session

    def _refuse(self, address: SocketAddress, why: str) -> None:
        self.relay.spares.fill()
        self.relay.deny(endpoint_of(address), why, "its datagrams are dropped")

    def _new_socket(self, is_stop: bool) -> socket.socket:
        """Open a socket towards the controller, for a stop at the expense of others.

        Raises:
            OSError: there is no way to the controller, or no file descriptor.
        """
        while True:
            try:
                return connect_datagrams(*self.controller)
            except OSError as error:
                if not is_stop or not none_left(error) or not self.relay.free_descriptor():
                    raise

    def _tell_wayless(self, address: SocketAddress, error: OSError) -> None:
        self._wayless += 1
        if is_told(self._wayless):
            self.relay.tell(
                f"{endpoint_of(address)}: the controller {self.to} cannot be reached: {reason(error)}"
            )

    def _count_drops(self) -> None:
        dropped = drops(self.sender)
        self.relay.counts[Count.LOST] += dropped - self._dropped
        self._dropped = dropped


class UdpSession:
    """A client and its socket.

    Attributes:
        number: of the client.
        conversation: between the client and the controller.
        source: where the client comes from.
        heard: `Relay.now` when the client was last heard.
        send_up: sends to the controller.
    """

    __slots__ = (
        "_address",
        "_dropped",
        "_port",
        "_relay",
        "_send_down",
        "_upstream",
        "conversation",
        "heard",
        "number",
        "send_up",
        "source",
    )

    def __init__(self, port: UdpPort, address: SocketAddress, upstream: socket.socket) -> None:
        """Take in a client that was heard for the first time."""
        relay = port.relay
        client = endpoint_of(address)
        self.number = relay.next_number()
        self.conversation = conversation(client, port.to, Transport.UDP)
        self.source = source_of(address[0])
        self.heard = relay.now
        self.send_up = upstream.send
        self._upstream = upstream
        self._port = port
        self._relay = relay
        self._address = address
        self._send_down = port.sender.sendto
        self._dropped = 0
        relay.watch(upstream.fileno(), self._passing() if relay.policy is None else self._ruled())
        ends = client, facing(port.sender, address), endpoint_of(upstream.getsockname()), port.to
        relay.meet(self, ends, time.time_ns())

    @property
    def state(self) -> str:
        """How the way to the controller is, as far as datagrams can tell."""
        return "refused" if self._port.refused else "open"

    def send(self, up: bool, data: bytes) -> int:
        """Send a datagram; return when, 0 if the system would not."""
        left = time.time_ns()
        try:
            if up:
                self.send_up(data)
            else:
                self._send_down(data, self._address)
        except OSError as error:
            left = self.send_again(data, error) if up else self._refuse(data, error)
        if left:
            self._relay.counts[Count.LEFT_UP if up else Count.LEFT_DOWN] += 1
        return left

    def send_again(self, data: bytes, error: OSError) -> int:
        """Send up what the system did not take, if it only had to tell of an earlier datagram first."""
        if not isinstance(error, ConnectionRefusedError):
            return self._refuse(data, error)
        self._tell_refused()
        left = time.time_ns()
        try:
            self.send_up(data)
        except OSError as again:
            return self._refuse(data, again)
        return left

    def leave(self, requests: Sequence[bytes], until: float) -> int:
        """Send requests in the client's place, each after the answer to the one before; return how many
        were answered. It waits, so nothing else passes meanwhile; from `until`, seconds of `time.monotonic`,
        nothing more is sent.
        """
        for count, request in enumerate(requests):
            if not any(time.monotonic() < until and self._ask(request) for _ in range(_TRIES)):
                return count
        return len(requests)

    def _ask(self, request: bytes) -> bool:
        """Send a request and wait for its answer."""
        relay = self._relay
        left = self.send(True, request)
        relay.ring.put(True, self.number, 0, left, request, note=b"the proxy ends the session")
        until = time.monotonic() + _PATIENCE
        while (rest := until - time.monotonic()) > 0 and can_be_read(self._upstream.fileno(), rest):
            try:
                data, control, _, _ = receiver(self._upstream)(LARGEST, CONTROL)
            except OSError:
                return False
            relay.ring.put(False, self.number, kernel_time(control, time.time_ns()), 0, data)
            if data[5:7] == request[5:7] and data[9:13] != _STILL_EXECUTING:
                return True
        return False

    def quiet(self, now: int) -> int | None:
        """Return the ns for which the client was silent, if that is too long when others want its place."""
        silent = now - self.heard
        return silent if silent >= GIVE_WAY_AFTER else None

    def passed_on(self, up: bool) -> None:
        """Do nothing: datagrams have no end."""

    def read_on(self) -> None:
        """Do nothing: datagrams are always read."""

    def close(self, reset: bool, why: str) -> None:
        """Close the socket, after what rules still give out of what they held."""
        self._relay.let_go(self)
        if self._upstream.fileno() < 0:  # that ended it: a rule says so
            return
        self._count_drops()
        self._relay.unwatch(self._upstream.fileno())
        self._upstream.close()
        self._port.forget(self._address)
        self._relay.part(self, why)

    def sweep(self, now: int) -> None:
        """Count what the system dropped; who is silent is the port's business."""
        self._count_drops()

    def _passing(self) -> Handler:
        """Make what passes datagrams on as they come; all that it needs is at hand, as it runs so often."""
        receive, send, address, number = receiver(self._upstream), self._send_down, self._address, self.number
        ring, port, now = self._relay.ring, self._port, time.time_ns
        notes, note, flush = ring.notes, ring.notes.append, ring.flush

        def take(_: int) -> None:
            try:
                data, control, _flags, _from = receive(LARGEST, CONTROL)
            except OSError as error:
                self._trouble(error)
                return
            left = now()
            try:
                send(data, address)
            except OSError as error:
                left = self._refuse(data, error)
            note((False, number, control, left, data))
            if len(notes) >= BATCH:
                flush()
            if port.refused:
                port.refused = False

        return take

    def _ruled(self) -> Handler:
        """Make what asks the rules first."""
        receive, relay, port = receiver(self._upstream), self._relay, self._port

        def take(_: int) -> None:
            try:
                data, control, _flags, _from = receive(LARGEST, CONTROL)
            except OSError as error:
                self._trouble(error)
                return
            port.refused = False
            relay.counts[Count.CAME_DOWN] += 1
            relay.rule(self, False, data, kernel_time(control, 0))

        return take

    def _trouble(self, error: OSError) -> None:
        """Tell of a refusal by ICMP; anything else is no datagram, and that is all."""
        if isinstance(error, ConnectionRefusedError):
            self._tell_refused()

    def _tell_refused(self) -> None:
        """Tell once, until something comes from the controller again."""
        if not self._port.refused:
            self._port.refused = True
            self._relay.tell(f"{self._port.to} refuses datagrams: nobody listens on UDP there (ICMP)")

    def _refuse(self, data: bytes, error: OSError) -> int:
        """Count what cannot be sent."""
        relay = self._relay
        relay.counts[Count.FULL] += 1
        if is_told(relay.counts[Count.FULL]):
            relay.tell(f"{self.conversation.client}: {len(data)} bytes could not be sent: {reason(error)}")
        return 0

    def _count_drops(self) -> None:
        dropped = drops(self._upstream)
        self._relay.counts[Count.LOST] += dropped - self._dropped
        self._dropped = dropped
