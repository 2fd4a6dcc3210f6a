"""UDP clients. Each client has its own socket toward the controller: the controller knows clients by port."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from contextlib import suppress

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.first_frame import first_frame_stops
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.proxy.listener_spec import ListenerSpec
from bcapscope.proxy.poller import Handler
from bcapscope.proxy.relay import Relay, encode_note
from bcapscope.proxy.relay_session import ClientDeniedError, ClientEndpoints, ClientListener, RelaySession
from bcapscope.proxy.ring_buffer import BATCH_SIZE, RelayCounter
from bcapscope.proxy.sockets import (
    LARGEST_DATAGRAM,
    SocketAddress,
    connect_datagrams,
    dropped_datagrams,
    endpoint_of,
    local_address_for,
    should_report,
)
from bcapscope.traffic.observation import Transport
from bcapscope.transport.descriptors import wait_readable
from bcapscope.transport.receive_timestamps import ANCILLARY_SIZE, kernel_timestamp, receive_function

EXPIRE_AFTER_NS = 600_000_000_000
"""The relay removes a client that is silent for this time in ns. If a removed client sends again, the
controller sees a new client. The time can be long: the socket of a silent client costs almost nothing.
"""

EVICTABLE_AFTER_NS = 10_000_000_000
"""If all slots are taken, a new client may replace a client that has been silent for this time in ns, as in
DENSO's C server (orin_bcap C/src/bCAPServer/bcap_server.c).
"""

_MAX_OLD = 10_000
MAX_ATTEMPTS = 2
REPLY_WITHIN = 0.3
"""Seconds to wait for the reply to one attempt of a request that closes a session."""

_STILL_EXECUTING = S_EXECUTING.to_bytes(4, "little")

MAX_STRANGERS = 256
"""Maximum number of rejected addresses to report to the user, each address once."""


class _DropCounter:
    """Counts the datagrams that the system dropped because the receive buffer of a socket was full."""

    def __init__(self, relay: Relay, sock: socket.socket) -> None:
        self._relay = relay
        self._socket = sock
        self._dropped = 0

    def update(self) -> None:
        dropped = dropped_datagrams(self._socket)
        self._relay.counts[RelayCounter.LOST] += dropped - self._dropped
        self._dropped = dropped


class UdpListener(ClientListener):
    """A UDP socket to which clients send their requests. `sessions` maps client addresses to sessions of
    clients that have sent more than one datagram. `refused` is True while the controller refuses datagrams.
    """

    def __init__(self, relay: Relay, spec: ListenerSpec, forget_after: int = EXPIRE_AFTER_NS) -> None:
        super().__init__(relay, spec, Transport.UDP)
        self.refused = False
        self._forget_after = forget_after
        self.sessions: dict[SocketAddress, UdpSession] = {}
        self._fresh_sessions: dict[SocketAddress, UdpSession] = {}
        self._strangers: set[str] = set()
        self._drops = _DropCounter(relay, self.socket)
        self._unreachable_count = 0

    def open(self) -> None:
        """Discard the datagrams that already wait, because the controller must not get outdated requests."""
        with suppress(OSError):
            for _ in range(_MAX_OLD):
                self.socket.recv(LARGEST_DATAGRAM)
        self.relay.watch(self.socket.fileno(), _datagram_handler(self, self.socket))

    def close(self) -> None:
        """Stop receiving. The socket stays open, to send replies to clients."""
        self._drops.update()
        super().close()

    def sweep(self, now: int) -> None:
        self._drops.update()
        for session in (*self.sessions.values(), *self._fresh_sessions.values()):
            if now - session.last_heard > self._forget_after:
                session.close(False, Message("client.silent", seconds=self._forget_after // 1_000_000_000))

    def remove_session(self, address: SocketAddress) -> None:
        self.sessions.pop(address, None)
        self._fresh_sessions.pop(address, None)

    def session_for(self, address: SocketAddress, data: bytes) -> UdpSession | None:
        """Return the session of a client that is not in `sessions` yet; None if the client is rejected."""
        session = self._fresh_sessions.pop(address, None)
        if session is not None:
            self.sessions[address] = session
            self.relay.slots[Transport.UDP].mark_established(session.number)
            return session
        if not self._spec.allows(address[0]):
            self._reject_stranger(address)
            return None
        return self._admit(address, first_frame_stops(data))

    def _reject_stranger(self, address: SocketAddress) -> None:
        relay = self.relay
        relay.counts[RelayCounter.DENIED] += 1
        if address[0] not in self._strangers and len(self._strangers) < MAX_STRANGERS:
            self._strangers.add(address[0])
            client, reason = str(endpoint_of(address)), Message("client.not-allowed")
            relay.notify(Message("client.denied.datagrams", client=client, reason=reason))

    def _admit(self, address: SocketAddress, is_stop: bool) -> UdpSession | None:
        relay = self.relay
        try:
            upstream, slot = self._open_upstream(
                address[0], is_stop, lambda: connect_datagrams(*self.controller)
            )
        except ClientDeniedError as error:
            relay.spares.refill()
            relay.deny(endpoint_of(address), error.message, is_datagram=True)
            return None
        except OSError as error:
            self._notify_unreachable(address, error)
            return None
        session = self._fresh_sessions[address] = UdpSession(self, address, upstream)
        relay.slots[Transport.UDP].occupy(session, slot, is_fresh=True)
        return session

    def _notify_unreachable(self, address: SocketAddress, error: OSError) -> None:
        self._unreachable_count += 1
        if should_report(self._unreachable_count):
            ends = {"client": str(endpoint_of(address)), "controller": str(self.to)}
            self.relay.notify(Message("client.no-controller", reason=os_reason(error), **ends))


class UdpSession(RelaySession):
    def __init__(self, listener: UdpListener, address: SocketAddress, upstream: socket.socket) -> None:
        relay = listener.relay
        super().__init__(relay, Transport.UDP, address, listener.to)
        self._send_up = upstream.send
        self._upstream = upstream
        self._listener = listener
        self._address = address
        self._send_down = listener.socket.sendto
        self._drops = _DropCounter(relay, upstream)
        relay.watch(upstream.fileno(), _datagram_handler(listener, upstream, self))
        ends = ClientEndpoints(
            Transport.UDP,
            self.conversation.client,
            local_address_for(listener.socket, address),
            endpoint_of(upstream.getsockname()),
            listener.to,
        )
        relay.add_client(self, ends, time.time_ns())

    @property
    def upstream_state(self) -> str:
        return "refused" if self._listener.refused else "open"

    def send(self, up: bool, data: bytes) -> int:
        sent_at = self.forward(up, data)
        if sent_at:
            self._relay.counts[RelayCounter.LEFT_UP if up else RelayCounter.LEFT_DOWN] += 1
        return sent_at

    def forward(self, up: bool, data: bytes) -> int:
        """Like `send`, but do not count the datagram. Return 0 if the system refused to send the datagram."""
        sent_at = time.time_ns()
        try:
            if up:
                self._send_up(data)
            else:
                self._send_down(data, self._address)
        except OSError as error:
            if not up or not isinstance(error, ConnectionRefusedError):
                return self._count_send_failure(data, error)
            # The controller refused an earlier datagram. The system reported that refusal only now, and did
            # not send `data`. So send `data` again.
            self.notify_refused()
            sent_at = time.time_ns()
            try:
                self._send_up(data)
            except OSError as again:
                return self._count_send_failure(data, again)
        return sent_at

    def send_closing_requests(self, requests: Sequence[bytes], until: float) -> int:
        """Send requests on behalf of the client, each after the reply to the previous request. Send nothing
        after `until`, a time of `time.monotonic`. Return how many requests got a reply. This method blocks
        the relay.
        """
        for count, request in enumerate(requests):
            if not any(time.monotonic() < until and self._request(request) for _ in range(MAX_ATTEMPTS)):
                return count
        return len(requests)

    def _request(self, request: bytes) -> bool:
        """Send a request. Return whether a reply, not only a notice, arrives within `REPLY_WITHIN`."""
        relay = self._relay
        sent_at = self.send(True, request)
        note = encode_note(Message("session.closing"))
        relay.ring.write_record(True, self.number, 0, sent_at, request, note=note)
        until = time.monotonic() + REPLY_WITHIN
        while (rest := until - time.monotonic()) > 0 and wait_readable(self._upstream.fileno(), rest):
            try:
                data, control, _, _ = receive_function(self._upstream)(LARGEST_DATAGRAM, ANCILLARY_SIZE)
            except OSError:
                return False
            relay.ring.write_record(False, self.number, kernel_timestamp(control, time.time_ns()), 0, data)
            if data[5:7] == request[5:7] and data[9:13] != _STILL_EXECUTING:
                return True
        return False

    def evictable_idle_ns(self, now: int) -> int | None:
        silent = now - self.last_heard
        return silent if silent >= EVICTABLE_AFTER_NS else None

    def close(self, reset: bool, why: Message) -> None:
        self._relay.release_held(self)
        if self._upstream.fileno() < 0:  # while held messages were released, a rule has closed the session
            return
        self._drops.update()
        self._relay.unwatch(self._upstream.fileno())
        self._upstream.close()
        self._listener.remove_session(self._address)
        self._relay.remove_client(self, why)

    def sweep(self, now: int) -> None:
        self._drops.update()  # the listener removes silent clients

    def notify_refused(self) -> None:
        """Report a refused datagram, but after that no further one until the controller sends a datagram."""
        if not self._listener.refused:
            self._listener.refused = True
            self._relay.notify(Message("client.refuses-datagrams", controller=str(self._listener.to)))

    def _count_send_failure(self, data: bytes, error: OSError) -> int:
        """Count a datagram that the system refused to send, and return 0."""
        relay = self._relay
        relay.counts[RelayCounter.FULL] += 1
        if should_report(relay.counts[RelayCounter.FULL]):
            client = str(self.conversation.client)
            relay.notify(Message("client.not-sent", client=client, size=len(data), reason=os_reason(error)))
        return 0


def _datagram_handler(
    listener: UdpListener, sock: socket.socket, session: UdpSession | None = None
) -> Handler:
    """Return a handler that forwards the datagrams of a socket, or passes them to the rules. With `session`,
    the socket receives replies for this session. For speed, the handler uses only local variables.
    """
    receive, known, up = receive_function(sock), listener.sessions.get, session is None
    relay, ring, has_rules = listener.relay, listener.relay.ring, listener.relay.policy is not None
    pending, append, flush = ring.pending_datagrams, ring.pending_datagrams.append, ring.flush
    counter = RelayCounter.CAME_UP if up else RelayCounter.CAME_DOWN

    def on_datagram(_: int) -> None:
        try:
            data, control, _flags, address = receive(LARGEST_DATAGRAM, ANCILLARY_SIZE)
        # there was no datagram, or Windows reported that the port of an earlier client is closed
        except OSError as error:
            if session is not None and isinstance(error, ConnectionRefusedError):
                session.notify_refused()
            return
        client = session or known(address) or listener.session_for(address, data)
        if client is None:
            return
        if up:
            client.last_heard = relay.now
        else:
            listener.refused = False
        if has_rules:
            relay.counts[counter] += 1
            relay.apply_rules(client, up, data, kernel_timestamp(control, 0))
            return
        append((up, client.number, control, client.forward(up, data), data))
        if len(pending) >= BATCH_SIZE:
            flush()

    return on_datagram
