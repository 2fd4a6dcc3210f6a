"""The socket to which TCP clients connect, and the admission of these clients."""

from __future__ import annotations

import errno
import socket
from functools import partial

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.first_frame import first_frame_stops
from bcapscope.proxy.listener_spec import ListenerSpec
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.relay_session import ClientDeniedError, ClientListener
from bcapscope.proxy.sockets import SocketAddress, endpoint_of
from bcapscope.proxy.tcp_session import TcpSession
from bcapscope.traffic.observation import Transport
from bcapscope.transport.descriptors import accept_connection
from bcapscope.transport.socket_link import close_with_reset

_MAX_ACCEPTED = 16
"""Maximum number of clients to accept before the relay serves other sockets."""


class TcpListener(ClientListener):
    def __init__(self, relay: Relay, spec: ListenerSpec) -> None:
        super().__init__(relay, spec, Transport.TCP)
        self._is_pause_reported = False

    def open(self) -> None:
        self.relay.watch(self.socket.fileno(), self._on_acceptable)

    def close(self) -> None:
        super().close()
        self.socket.close()

    def _on_acceptable(self, _: int) -> None:
        for _ in range(_MAX_ACCEPTED):
            if not self._accept():
                return

    def _accept(self) -> bool:
        """Accept one waiting client. Return False if no client waited, or if an error occurred."""
        relay = self.relay
        try:
            accepted = accept_connection(self.socket, partial(relay.free_descriptor, is_admitted=False))
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

    def _admit(self, client: socket.socket, address: SocketAddress, first: bytes, received_at: int) -> None:
        """Connect to the controller for a client that has sent its first frame."""
        relay = self.relay
        try:
            server, slot = self._open_upstream(
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
        session = TcpSession(relay, self.to, (client, server), address, (first, received_at))
        relay.slots[Transport.TCP].occupy(session, slot, is_fresh=False)
        if problem not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            session.fail(problem)

    def _refuse(self, client: socket.socket, address: SocketAddress, why: Message) -> None:
        close_with_reset(client)
        self.relay.spares.refill()
        self.relay.deny(endpoint_of(address), why)

    def _pause_accepting(self, error: OSError) -> None:
        """Stop accepting clients for about a second. Report only the first of several errors in a row."""
        if not self._is_pause_reported:
            self._is_pause_reported = True
            self.relay.notify(
                Message("client.none-accepted", address=str(self.address), reason=os_reason(error))
            )
        self.relay.pause(self.socket.fileno())
