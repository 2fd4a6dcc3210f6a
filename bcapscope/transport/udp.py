"""UDP to one peer."""

from __future__ import annotations

import asyncio
from typing import cast

from bcapscope.transport.link import Address, Receiver


class UdpLink(asyncio.DatagramProtocol):
    """A socket connected to its peer: the system drops what others send, and tells of closed ports."""

    datagrams = True

    def __init__(self, receiver: Receiver) -> None:
        self._receiver: Receiver | None = receiver
        self._transport: asyncio.DatagramTransport | None = None

    @property
    def local(self) -> Address:
        """Our end."""
        return self._end("sockname")

    @property
    def peer(self) -> Address:
        """The other end."""
        return self._end("peername")

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        if self._transport is not None:
            self._transport.sendto(data)

    def close(self) -> None:
        """Close the socket."""
        self._receiver = None
        if self._transport is not None:
            self._transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # A cast, as asyncio's own class is no DatagramTransport before Python 3.12.
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        if self._receiver is not None:
            self._receiver.received(data)

    def error_received(self, exc: Exception) -> None:
        if self._receiver is not None:
            self._receiver.trouble(_words(exc))

    def connection_lost(self, exc: Exception | None) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.lost("the socket was closed" if exc is None else _words(exc))

    def _end(self, which: str) -> Address:
        assert self._transport is not None
        host, port, *_ = self._transport.get_extra_info(which)
        return host, port


def _words(error: Exception) -> str:
    return str(error.strerror if isinstance(error, OSError) and error.strerror else error).lower()


async def open_udp(host: str, port: int, receiver: Receiver) -> UdpLink:
    """Open a socket to `host`.

    Raises:
        OSError: there is no such host, or no way to it.
    """
    loop = asyncio.get_running_loop()
    _, link = await loop.create_datagram_endpoint(lambda: UdpLink(receiver), remote_addr=(host, port))
    return link
