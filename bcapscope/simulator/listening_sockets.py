"""Opening the listening sockets of the simulator."""

from __future__ import annotations

import socket

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.transport.receive_timestamps import enable_receive_timestamps

_RECEIVE_BUFFER = 4 << 20
"""Requested size in bytes of the buffer for waiting datagrams; the system may grant less."""

_BACKLOG = 1024
"""Maximum number of connections to accept; beyond it, a new client retries after a second."""


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
    raise AssertionError("the last attempt returns or raises")


def _bind(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    word = "TCP" if kind == socket.SOCK_STREAM else "UDP"
    sock = None
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE)[0]
        sock = socket.socket(family, kind)
        sock.setblocking(False)
        if kind == socket.SOCK_STREAM:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
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
