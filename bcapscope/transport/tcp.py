"""TCP to one peer."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress

from bcapscope.transport.link import Address, Receiver


class TcpLink(asyncio.Protocol):
    """A connection. asyncio sends small pieces at once (TCP_NODELAY), which set points need."""

    datagrams = False

    def __init__(self, receiver: Receiver) -> None:
        self._receiver: Receiver | None = receiver
        self._transport: asyncio.Transport | None = None

    @property
    def local(self) -> Address:
        """Our end."""
        return self._end("sockname")

    @property
    def peer(self) -> Address:
        """The other end."""
        return self._end("peername")

    def send(self, data: bytes) -> None:
        """Send the next bytes of the stream."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def close(self) -> None:
        """Close the connection; what was sent still goes out."""
        self._receiver = None
        if self._transport is not None:
            self._transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        if self._receiver is not None:
            self._receiver.received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.lost("the peer closed the connection" if exc is None else f"the connection broke: {exc}")

    def _end(self, which: str) -> Address:
        assert self._transport is not None
        host, port, *_ = self._transport.get_extra_info(which)
        return host, port


async def open_tcp(host: str, port: int, receiver: Receiver, timeout: float = 5.0) -> TcpLink:
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


def reset(sock: socket.socket) -> None:
    """Close a stream by RST."""
    with suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    sock.close()
