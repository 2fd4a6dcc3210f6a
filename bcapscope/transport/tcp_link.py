"""TCP to one peer."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress

from bcapscope.transport.peer_link import LinkReceiver
from bcapscope.transport.socket_link import SocketLink


class TcpLink(SocketLink[asyncio.Transport], asyncio.Protocol):
    """A connection. asyncio sends small pieces at once (TCP_NODELAY), which set points need."""

    datagrams = False
    end_reason = "the peer closed the connection"

    def send(self, data: bytes) -> None:
        """Send the next bytes of the stream."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        if self._receiver is not None:
            self._receiver.on_data(data)


async def open_tcp(host: str, port: int, receiver: LinkReceiver, timeout: float = 5.0) -> TcpLink:
    """Connect to `host`.

    Args:
        host: name or address.
        port: of the server.
        receiver: is told what comes.
        timeout: seconds.

    Raises:
        OSError: there is no such host, no way to it, or nobody listens; TimeoutError is one of these.
    """
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(timeout):
        _, link = await loop.create_connection(lambda: TcpLink(receiver), host, port)
    return link


def close_with_reset(sock: socket.socket) -> None:
    """Close a stream by RST."""
    with suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    sock.close()
