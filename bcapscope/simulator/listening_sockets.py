"""Open the listening sockets of the simulator, and queue the datagrams that it has not processed."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Hashable, Iterator

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.transport.listening import allow_restart
from bcapscope.transport.receive_timestamps import enable_receive_timestamps

_RECEIVE_BUFFER = 4 << 20
"""Requested size in bytes of the buffer for waiting datagrams; the system may grant less."""

_BACKLOG = 1024
"""Maximum number of connections that wait to be accepted. If this number is reached, Linux ignores the next
client. That client tries again after one second.
"""


class SimulatorListenError(BcapError):
    """The simulator cannot listen on an address."""


def open_sockets(host: str, port: int) -> tuple[socket.socket, socket.socket]:
    """Open a UDP and a TCP socket on one port, or raise SimulatorListenError; port 0 means any free port."""
    for attempts_left in range(0 if port else 20, -1, -1):
        tcp = _bind(host, port, socket.SOCK_STREAM)
        try:
            return _bind(host, tcp.getsockname()[1], socket.SOCK_DGRAM), tcp
        except SimulatorListenError:
            tcp.close()
            if not attempts_left:
                raise
    raise AssertionError("the loop always returns or raises")


def _bind(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    word = "TCP" if kind == socket.SOCK_STREAM else "UDP"
    sock = None
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE)[0]
        sock = socket.socket(family, kind)
        sock.setblocking(False)
        if kind == socket.SOCK_STREAM:
            allow_restart(sock)
        else:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            enable_receive_timestamps(sock)
        sock.bind(address)
        if kind == socket.SOCK_STREAM:
            sock.listen(_BACKLOG)
    except OSError as error:
        if sock is not None:
            sock.close()
        raise SimulatorListenError(
            Message("listen.failed", host=host, transport=word, port=port, reason=os_reason(error))
        ) from error
    return sock


MAX_PER_SENDER = 32
"""Maximum number of waiting datagrams of one sender: enough for a call's attempts and a few more calls."""

MAX_BYTES = 2 << 20
"""Maximum total size of all waiting datagrams in bytes. The size of a datagram is its length plus `_COST`."""

_COST = 512


class DatagramQueue:
    """Waiting datagrams by sender, oldest first; `dropped` is the number of datagrams that did not fit."""

    def __init__(self) -> None:
        self.waiting: dict[Hashable, deque[tuple[int, bytes]]] = {}
        self.dropped = 0
        self._bytes = 0

    @property
    def oldest_arrival(self) -> int:
        return min(queue[0][0] for queue in self.waiting.values())

    def add(self, sender: Hashable, received_at: int, data: bytes) -> None:
        queue = self.waiting.get(sender)
        size = len(data) + _COST
        if self._bytes + size > MAX_BYTES or (queue is not None and len(queue) >= MAX_PER_SENDER):
            self.dropped += 1
            return
        if queue is None:
            queue = self.waiting[sender] = deque()
        queue.append((received_at, data))
        self._bytes += size

    def pop_one_per_sender(self) -> Iterator[tuple[Hashable, int, bytes]]:
        for sender in list(self.waiting):
            queue = self.waiting[sender]
            came, data = queue.popleft()
            self._bytes -= len(data) + _COST
            if not queue:
                del self.waiting[sender]
            yield sender, came, data
