"""A TCP link to one peer."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress

from bcapscope.transport.peer_link import LinkReceiver
from bcapscope.transport.socket_link import SocketLink


class TcpLink(SocketLink[asyncio.Transport], asyncio.Protocol):
    """A TCP connection. asyncio sets TCP_NODELAY, so a set point is sent without delay."""

    datagrams = False
    end_reason = "connection.closed-by-peer"

    def send(self, data: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        if self._receiver is not None:
            self._receiver.on_data(data)


async def open_tcp(host: str, port: int, receiver: LinkReceiver, timeout: float = 5.0) -> TcpLink:
    """Connect to `host` within `timeout` s and return the link.

    Raises:
        OSError: The host is unknown or unreachable, or nothing listens on the port; TimeoutError is a
            subclass.
    """
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(timeout):
        _, link = await loop.create_connection(lambda: TcpLink(receiver), host, port)
    return link


def close_with_reset(sock: socket.socket) -> None:
    with suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    sock.close()
