"""Base classes for the relay's sessions and listeners, and the addresses of a client's connections."""

from __future__ import annotations

import errno
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.admission import ClientSlot
from bcapscope.proxy.listener_spec import ListenerSpec
from bcapscope.proxy.ring_buffer import RelayCounter
from bcapscope.proxy.sockets import SocketAddress, endpoint_of, listen_on, resolve
from bcapscope.traffic.observation import SERVER_PARTICIPANT, Conversation, Endpoint, Transport
from bcapscope.transport.descriptors import is_out_of_descriptors
from bcapscope.transport.first_frame_queue import source_network

if TYPE_CHECKING:
    from bcapscope.proxy.relay import Relay


class ClientDeniedError(BcapError):
    """No slot or file descriptor is free for a new client."""


class RelaySession(ABC):
    """Forwards data between one client and the controller. `conversation` has their addresses, not those of
    the proxy. `last_heard` is the value of `Relay.now` when the client last sent something.
    """

    def __init__(self, relay: Relay, transport: Transport, client: SocketAddress, to: Endpoint) -> None:
        self.number = relay.counts[RelayCounter.CLIENTS] + 1
        self.conversation = Conversation(endpoint_of(client), to, transport, SERVER_PARTICIPANT)
        self.source = source_network(client[0])
        self.last_heard = relay.now
        self._relay = relay

    @property
    @abstractmethod
    def upstream_state(self) -> str:
        """State of the connection to the controller: open, connecting, connected, half-open or refused."""

    @abstractmethod
    def send(self, up: bool, data: bytes) -> int:
        """Send data to the controller (`up`) or to the client. Return the time of sending in ns since 1970; 0
        if part of the data was not sent.
        """

    def resume(self) -> None:  # noqa: B027 - a UDP session never pauses, and needs no code here
        """After the rules have released held data, forward a delayed FIN, and read from paused sockets."""

    @abstractmethod
    def sweep(self, now: int) -> None:
        """Do the periodic work; `now` is the value of `Relay.now`."""

    @abstractmethod
    def evictable_idle_ns(self, now: int) -> int | None:
        """Return how many ns the client has been idle; None if the proxy must not evict the client."""

    @abstractmethod
    def close(self, reset: bool, why: Message) -> None:
        """First send the held messages that the rules release, then close the session. With `reset`, TCP
        connections end with an RST, but not the connection to the controller if held requests were sent to
        it.
        """


class ClientListener(ABC):
    """A socket that accepts clients for one controller. `controller` is the controller's address family and
    socket address.
    """

    def __init__(self, relay: Relay, spec: ListenerSpec, transport: Transport) -> None:
        """Open the socket. Raise the errors of `resolve` and `listen_on`."""
        self.relay = relay
        self.controller = resolve(spec.to, transport)
        self.to = endpoint_of(self.controller[1])
        self.socket = listen_on(spec.listen, transport)
        self.address = endpoint_of(self.socket.getsockname())
        self._spec = spec
        self._transport = transport

    @abstractmethod
    def open(self) -> None:
        """Start to accept clients."""

    def close(self) -> None:
        self.relay.unwatch(self.socket.fileno())

    def release(self) -> None:
        """Close the listener's socket. Call this method after `close`, when no session uses the listener."""
        self.socket.close()

    def sweep(self, now: int) -> None:  # noqa: B027 - not every listener has periodic work
        """Do the periodic work; `now` is the value of `Relay.now`."""

    def _open_upstream(
        self, host: str, is_stop: bool, open_socket: Callable[[], socket.socket]
    ) -> tuple[socket.socket, ClientSlot]:
        """Find a slot for a new client at the address `host`, and open a socket toward the controller. If the
        client's first frame is a stop and no file descriptor is free, disconnect another client.
        """
        relay = self.relay
        slot = relay.slots[self._transport].find_slot(host, relay.now, is_stop)
        if slot is ClientSlot.NONE:
            raise ClientDeniedError(Message("client.too-many"))
        while True:
            try:
                upstream = open_socket()
                break
            except OSError as error:
                if not is_stop or not is_out_of_descriptors(error) or not relay.free_descriptor():
                    raise
        if relay.spares.refill():
            return upstream, slot
        if not is_stop:
            upstream.close()
            reason = os_reason(OSError(errno.EMFILE, ""))
            raise ClientDeniedError(Message("client.not-accepted", reason=reason))
        return upstream, ClientSlot.RESERVED


class ClientEndpoints(NamedTuple):
    """Addresses of the connections from `client` to the proxy at `listen`, and from the proxy at `upstream`
    to the controller.
    """

    transport: Transport
    client: Endpoint
    listen: Endpoint
    upstream: Endpoint
    controller: Endpoint

    def to_json(self) -> bytes:
        """Return the data of a `CLIENT_OPENED` record."""
        return msgspec.json.encode(self)


def read_endpoints(data: bytes) -> ClientEndpoints:
    """Decode the data of a `CLIENT_OPENED` record."""
    return msgspec.json.decode(data, type=ClientEndpoints)
