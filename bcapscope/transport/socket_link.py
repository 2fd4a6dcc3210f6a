"""UDP and TCP links, which use asyncio sockets."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, TypeAlias

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.transport.peer_link import Address, LinkReceiver

AddressInfo: TypeAlias = tuple[int, int, int, str, Any]
"""One address in the form of `socket.getaddrinfo`."""

CONNECT_TIMEOUT = 5.0
"""Maximum time in s for opening a TCP connection."""


class SocketLink(asyncio.BaseProtocol):
    """A link over a connected socket. `end_reason` is the message id for an end without an error."""

    end_reason = "connection.socket-closed"

    def __init__(self, receiver: LinkReceiver) -> None:
        self._receiver: LinkReceiver | None = receiver
        self._transport: Any = None

    @property
    def local(self) -> Address:
        host, port, *_ = self._transport.get_extra_info("sockname")
        return host, port

    @property
    def peer(self) -> Address:
        host, port, *_ = self._transport.get_extra_info("peername")
        return host, port

    def close(self) -> None:
        """Close the socket. Over TCP, the socket closes only when all waiting data is sent."""
        self._receiver = None
        if self._transport is not None:
            self._transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.on_link_lost(
                Message(self.end_reason)
                if exc is None
                else Message("connection.broke", reason=os_reason(exc))
            )


class TcpLink(SocketLink, asyncio.Protocol):
    """A TCP connection. asyncio sets TCP_NODELAY, so a set point is sent without delay."""

    datagrams = False
    end_reason = "connection.closed-by-peer"

    def send(self, data: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def data_received(self, data: bytes) -> None:
        if self._receiver is not None:
            self._receiver.on_data(data)


async def open_tcp(host: str, port: int, receiver: LinkReceiver) -> TcpLink:
    """Connect to `host` within `CONNECT_TIMEOUT`, or raise OSError."""
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(CONNECT_TIMEOUT):
        _, link = await loop.create_connection(lambda: TcpLink(receiver), host, port)
    return link


def close_with_reset(sock: socket.socket) -> None:
    with suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    sock.close()


def preferred_address(addresses: Iterable[AddressInfo]) -> AddressInfo:
    """Return the first IPv4 address, because controllers use IPv4; else the first address.

    Over UDP, a wrong address looks like a controller that does not answer. For a name such as localhost, the
    system often lists an IPv6 address first.
    """
    return min(addresses, key=lambda each: each[0] != socket.AF_INET)


class UdpLink(SocketLink, asyncio.DatagramProtocol):
    """A connected UDP socket: the system drops datagrams of other senders, and reports a closed port."""

    datagrams = True

    def send(self, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data)

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        if self._receiver is not None:
            self._receiver.on_data(data)

    def error_received(self, exc: Exception) -> None:
        if self._receiver is not None:
            self._receiver.on_send_error(os_reason(exc))


async def open_udp(host: str, port: int, receiver: LinkReceiver) -> UdpLink:
    """Open a socket connected to `host`, or raise OSError if the host is unknown or unreachable."""
    loop = asyncio.get_running_loop()
    family, *_ = preferred_address(await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))
    _, link = await loop.create_datagram_endpoint(
        lambda: UdpLink(receiver), remote_addr=(host, port), family=family
    )
    return link
