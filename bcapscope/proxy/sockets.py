"""Open the sockets of the proxy, and hide differences between operating systems."""

from __future__ import annotations

import socket
import struct
import sys
from contextlib import suppress
from typing import Any, TypeAlias

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.traffic.observation import Endpoint, Transport
from bcapscope.transport.listening import allow_restart
from bcapscope.transport.receive_timestamps import enable_receive_timestamps

SocketAddress: TypeAlias = tuple[Any, ...]
"""Address in the form of the socket module: host and port, and for IPv6 also flow label and scope id."""

LARGEST_DATAGRAM = 65535

RECEIVE_BUFFER = 4 << 20
SO_RCVBUFFORCE, _SO_MEMINFO = 33, 55  # asm-generic/socket.h of Linux
_MEMINFO = struct.Struct("=9I")
_MEMINFO_DROPS = 8  # linux/sock_diag.h, SK_MEMINFO_DROPS
MAX_WAITING_CLIENTS = 1024
"""Maximum number of TCP connections that wait to be accepted. If more clients connect at once, the others try
again only after a second. This limit is high, because a second is too long for a client that sends a stop.
"""


class ProxyListenError(BcapError):
    """The proxy cannot listen on an address."""


class UnreachableError(BcapError):
    """The name of the controller cannot be resolved."""


def listen_on(endpoint: Endpoint, transport: Transport) -> socket.socket:
    """Open a socket for clients, or raise a `ProxyListenError`."""
    family = socket.AF_INET6 if ":" in endpoint.host else socket.AF_INET
    stream = transport is Transport.TCP
    sock = None
    try:
        sock = socket.socket(family, socket.SOCK_STREAM if stream else socket.SOCK_DGRAM)
        sock.setblocking(False)
        if family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        if stream:
            allow_restart(sock)
        sock.bind(_own_address(family, endpoint))
        if stream:
            sock.listen(MAX_WAITING_CLIENTS)
        else:
            prepare_datagrams(sock)
    except OSError as error:
        if sock is not None:
            sock.close()
        word, reason = transport.upper(), os_reason(error)
        message = Message(
            "listen.failed", host=endpoint.host, port=endpoint.port, transport=word, reason=reason
        )
        raise ProxyListenError(message) from None
    return sock


def _own_address(family: int, endpoint: Endpoint) -> SocketAddress:
    flags = socket.AI_NUMERICHOST | socket.AI_PASSIVE
    address: SocketAddress = socket.getaddrinfo(endpoint.host, endpoint.port, family, flags=flags)[0][4]
    return address


def resolve(endpoint: Endpoint, transport: Transport) -> tuple[int, SocketAddress]:
    """Return the address family and the socket address of a controller, or raise an `UnreachableError`."""
    kind = socket.SOCK_STREAM if transport is Transport.TCP else socket.SOCK_DGRAM
    try:
        family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
    except (OSError, UnicodeError) as error:
        message = Message("controller.unreachable", address=str(endpoint), reason=os_reason(error))
        raise UnreachableError(message) from None
    return family, address


def connect_datagrams(family: int, address: SocketAddress) -> socket.socket:
    """Open a UDP socket that receives datagrams from one address only."""
    sock = socket.socket(family, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        prepare_datagrams(sock)
        sock.connect(address)
    except OSError:
        sock.close()
        raise
    return sock


def prepare_datagrams(sock: socket.socket) -> None:
    """Request a large receive buffer and timestamps of receipt. The system may refuse both."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    if sys.platform == "linux":
        with suppress(OSError):  # only root may exceed the system's limit
            sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER)
    enable_receive_timestamps(sock)


def keep_alive(sock: socket.socket) -> None:
    """Let the system close a connection two minutes, not hours, after the other computer disappears."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 6)):
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def dropped_datagrams(sock: socket.socket) -> int:
    """Return how many datagrams the system dropped because a socket's buffer was full; 0 if unknown."""
    if sys.platform == "linux":
        with suppress(OSError, struct.error):
            found = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
            return int(_MEMINFO.unpack(found)[_MEMINFO_DROPS])
    return 0


def endpoint_of(address: SocketAddress) -> Endpoint:
    return Endpoint(address[0], address[1])


def local_address_for(sock: socket.socket, client: SocketAddress) -> Endpoint:
    """Return the address by which `client` reaches a UDP socket that may listen on all addresses."""
    own = sock.getsockname()
    if own[0] not in ("0.0.0.0", "::"):
        return endpoint_of(own)
    with suppress(OSError), socket.socket(sock.family, socket.SOCK_DGRAM) as probe:
        probe.connect(client)
        return Endpoint(probe.getsockname()[0], own[1])
    return endpoint_of(own)


def should_report(count: int) -> bool:
    """Return whether to report the event with this number: the 1st, 2nd, 4th, 8th and so on."""
    return count & (count - 1) == 0
