"""The socket to which TCP clients connect, and the admission of these clients."""

from __future__ import annotations

import errno
import socket

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.first_frame import first_frame_stops
from bcapscope.proxy.listener_spec import ListenerSpec
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.sockets import SocketAddress, endpoint_of, listen_on, resolve
from bcapscope.proxy.tcp_session import TcpSession
from bcapscope.proxy.upstream import ClientDeniedError, open_upstream
from bcapscope.traffic.observation import Transport
from bcapscope.transport.descriptors import accept_connection
from bcapscope.transport.tcp_link import close_with_reset

_MAX_ACCEPTED = 16
"""Maximum number of clients that are accepted before other sockets are served."""


class TcpListener:
    """A socket to which TCP clients connect.

    Attributes:
        address: Host and port on which the socket listens.
        controller: Address family and address of the controller.
        to: Host and port of the controller.
    """

    def __init__(self, relay: Relay, spec: ListenerSpec) -> None:
        """Open the socket for clients.

        Raises:
            ProxyListenError: The address cannot be listened on.
            UnreachableError: The controller's name cannot be resolved.
        """
        self.relay = relay
        self.controller = resolve(spec.to, Transport.TCP)
        self.to = endpoint_of(self.controller[1])
        self._socket = listen_on(spec.listen, Transport.TCP)
        self.address = endpoint_of(self._socket.getsockname())
        self._spec = spec
        self._is_pause_reported = False

    def open(self) -> None:
        self.relay.watch(self._socket.fileno(), self._on_acceptable)

    def close(self) -> None:
        self.relay.unwatch(self._socket.fileno())
        self._socket.close()

    def release(self) -> None:
        """Do nothing: `close` has closed the socket."""

    def sweep(self, now: int) -> None:
        """Do nothing: a TCP listener has no periodic work."""

    def _on_acceptable(self, _: int) -> None:
        for _ in range(_MAX_ACCEPTED):
            if not self._accept():
                return

    def _accept(self) -> bool:
        """Accept a client. Return whether another client may be waiting."""
        relay = self.relay
        try:
            accepted = accept_connection(self._socket, relay.free_newcomer_descriptor)
        except OSError as error:
            self._pause_accepting(error)
            return False
        if accepted is None:
            return False
        client, address = accepted
        self._is_pause_reported = False
        if self._spec.allows(address[0]):
            relay.pending_connections.add(client, address, self._admit)
        else:
            close_with_reset(client)
            relay.deny(endpoint_of(address), Message("client.not-allowed"))
        return True

    def _admit(self, client: socket.socket, address: SocketAddress, first: bytes, came: int) -> None:
        """Give a client a slot and a connection to the controller, after the client's first frame."""
        relay = self.relay
        try:
            server, slot = open_upstream(
                relay,
                Transport.TCP,
                address[0],
                first_frame_stops(first),
                lambda: socket.socket(self.controller[0], socket.SOCK_STREAM),
            )
        except ClientDeniedError as error:
            self._refuse(client, address, error.message)
            return
        except OSError as error:
            self._refuse(client, address, Message("client.not-accepted", reason=os_reason(error)))
            return
        server.setblocking(False)
        problem = server.connect_ex(self.controller[1])
        session = TcpSession(relay, self.to, (client, server), address, (first, came))
        relay.slots[Transport.TCP].occupy(session, slot, is_fresh=False)
        if problem not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            session.fail(problem)

    def _refuse(self, client: socket.socket, address: SocketAddress, why: Message) -> None:
        close_with_reset(client)
        self.relay.spares.refill()
        self.relay.deny(endpoint_of(address), why)

    def _pause_accepting(self, error: OSError) -> None:
        """Stop accepting clients for a while. Report this once, until a client can be accepted again."""
        if not self._is_pause_reported:
            self._is_pause_reported = True
            self.relay.notify(
                Message("client.none-accepted", address=str(self.address), reason=os_reason(error))
            )
        self.relay.pause(self._socket.fileno())
