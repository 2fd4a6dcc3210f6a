"""TCP clients without a complete first frame. The first frame decides whether a client gets a slot."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from bcapscope.messages import Message
from bcapscope.protocol.first_frame import LONGEST_FIRST_FRAME
from bcapscope.proxy.sockets import SocketAddress, endpoint_of
from bcapscope.transport.first_frame_queue import FirstFrameQueue
from bcapscope.transport.socket_link import close_with_reset

if TYPE_CHECKING:
    from bcapscope.proxy.relay import Relay

Admit: TypeAlias = Callable[[socket.socket, SocketAddress, bytes, int], None]
"""Function that admits a client. Arguments: socket, address, first bytes, their time in ns since 1970."""


class PendingConnections:
    def __init__(self, relay: Relay) -> None:
        self._relay = relay
        self._lobby: FirstFrameQueue[int] = FirstFrameQueue()
        self._clients: dict[int, tuple[socket.socket, SocketAddress, Admit]] = {}

    def __len__(self) -> int:
        return len(self._clients)

    def add(self, client: socket.socket, address: SocketAddress, admit: Admit) -> None:
        """Call `admit` when the client's first frame is complete."""
        client.setblocking(False)
        descriptor = client.fileno()
        dropped = self._lobby.add(descriptor, address[0])
        if dropped is not None:
            self._refuse(dropped, Message("client.silent.others"))
        self._clients[descriptor] = client, address, admit
        self._relay.watch(descriptor, lambda _: self._read(descriptor))
        self._read(descriptor)

    def drop_lowest_priority(self) -> bool:
        """Disconnect the pending client with the lowest priority. Return False if no client is pending."""
        dropped = self._lobby.drop_one()
        if dropped is None:
            return False
        self._refuse(dropped, Message("client.silent.descriptors"))
        return True

    def sweep(self, now: int) -> None:
        """Disconnect clients that take too long to send their first frame."""
        for descriptor in self._lobby.drop_overdue(now):
            self._refuse(descriptor, Message("client.slow-first-frame"))

    def close(self) -> None:
        while (descriptor := self._lobby.drop_one()) is not None:
            close_with_reset(self._remove(descriptor)[0])

    def _read(self, descriptor: int) -> None:
        client, address, admit = self._clients[descriptor]
        try:
            data = client.recv(LONGEST_FIRST_FRAME)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        received_at = time.time_ns()
        if not data:
            self._lobby.remove(descriptor)
            self._remove(descriptor)[0].close()
            return
        first = self._lobby.feed_bytes(descriptor, data, self._relay.now)
        if first is not None:
            self._remove(descriptor)
            admit(client, address, first, received_at)

    def _remove(self, descriptor: int) -> tuple[socket.socket, SocketAddress, Admit]:
        self._relay.unwatch(descriptor)
        return self._clients.pop(descriptor)

    def _refuse(self, descriptor: int, why: Message) -> None:
        client, address, _ = self._remove(descriptor)
        close_with_reset(client)
        self._relay.deny(endpoint_of(address), why)
