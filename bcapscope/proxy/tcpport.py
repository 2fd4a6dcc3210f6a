"""The socket that TCP clients connect to, and which of them become clients of the controller."""

from __future__ import annotations

import errno
import socket

from bcapscope.protocol.opening import begins_with_stop
from bcapscope.proxy.admission import Place
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.sockets import SocketAddress, endpoint_of, listen_on, reason, resolve
from bcapscope.proxy.spec import Listener
from bcapscope.proxy.tcp import TcpSession
from bcapscope.traffic.observation import Transport
from bcapscope.transport.descriptors import NO_DESCRIPTORS, accept, none_left
from bcapscope.transport.tcp import reset

_MOST_ACCEPTED = 16
"""Clients that are accepted before other sockets have their turn."""


class TcpPort:
    """A socket that clients connect to.

    Attributes:
        relay: whose it is.
        address: where it listens.
        controller: address family and address of the controller.
        to: the same as the user typed it.
    """

    def __init__(self, relay: Relay, listener: Listener) -> None:
        """Listen.

        Raises:
            ListenError: the address cannot be used.
        """
        self.relay = relay
        self.controller = resolve(listener.to, Transport.TCP)
        self.to = endpoint_of(self.controller[1])
        self._socket = listen_on(listener.listen, Transport.TCP)
        self.address = endpoint_of(self._socket.getsockname())
        self._listener = listener
        self._told = False

    def open(self) -> None:
        """Begin to take clients."""
        self.relay.watch(self._socket.fileno(), self._acceptable)

    def close(self) -> None:
        """Take no more clients."""
        self.relay.unwatch(self._socket.fileno())
        self._socket.close()

    def release(self) -> None:
        """Do nothing: the socket is closed by now."""

    def sweep(self, now: int) -> None:
        """Do nothing."""

    def _acceptable(self, _: int) -> None:
        for _ in range(_MOST_ACCEPTED):
            if not self._accept():
                return

    def _accept(self) -> bool:
        """Take a client; return whether another one may be waiting."""
        relay = self.relay
        try:
            accepted = accept(self._socket, relay.free_for_newcomer)
        except OSError as error:
            self._pause(error)
            return False
        if accepted is None:
            return False
        client, address = accepted
        self._told = False
        if self._listener.allows(address[0]):
            relay.entrance.enter(client, address, self._admit)
        else:
            reset(client)
            relay.deny(endpoint_of(address), "is not allowed")
        return True

    def _admit(self, client: socket.socket, address: SocketAddress, first: bytes, came: int) -> None:
        """Give a client that has sent its first frame a place and a connection to the controller."""
        relay = self.relay
        places, is_stop = relay.places[Transport.TCP], begins_with_stop(first)
        place = places.find(address[0], relay.now, is_stop)
        if place is Place.NONE:
            self._refuse(client, address, "is one client too many")
            return
        try:
            server = self._new_socket(is_stop)
        except OSError as error:
            self._refuse(client, address, f"cannot be accepted: {reason(error)}")
            return
        if not relay.spares.fill():
            place = Place.KEPT
            if not is_stop:
                server.close()
                self._refuse(client, address, f"cannot be accepted: {NO_DESCRIPTORS}")
                return
        server.setblocking(False)
        problem = server.connect_ex(self.controller[1])
        session = TcpSession(relay, self.to, (client, server), address, (first, came))
        places.take(session, place, is_fresh=False)
        if problem not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            session.fail(problem)

    def _refuse(self, client: socket.socket, address: SocketAddress, why: str) -> None:
        reset(client)
        self.relay.spares.fill()
        self.relay.deny(endpoint_of(address), why)

    def _new_socket(self, is_stop: bool) -> socket.socket:
        """Open a socket, for a stop at the expense of others.

        Raises:
            OSError: there is no file descriptor, or the like.
        """
        while True:
            try:
                return socket.socket(self.controller[0], socket.SOCK_STREAM)
            except OSError as error:
                if not is_stop or not none_left(error) or not self.relay.free_descriptor():
                    raise

    def _pause(self, error: OSError) -> None:
        """Accept no clients for a while; reports this once, until one can be accepted again."""
        if not self._told:
            self._told = True
            self.relay.tell(f"cannot accept clients on {self.address} TCP: {reason(error)}")
        self.relay.pause(self._socket.fileno())
