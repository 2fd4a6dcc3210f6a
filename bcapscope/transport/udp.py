"""UDP to one peer."""

from __future__ import annotations

import asyncio
from typing import cast

from bcapscope.transport.link import Receiver
from bcapscope.transport.socketlink import SocketLink, words


class UdpLink(SocketLink[asyncio.DatagramTransport], asyncio.DatagramProtocol):
    """A socket connected to its peer: the system drops what others send, and tells of closed ports."""

    datagrams = True

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        if self._transport is not None:
            self._transport.sendto(data)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # A cast, as asyncio's own class is no DatagramTransport before Python 3.12.
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        if self._receiver is not None:
            self._receiver.received(data)

    def error_received(self, exc: Exception) -> None:
        if self._receiver is not None:
            self._receiver.trouble(words(exc))


async def open_udp(host: str, port: int, receiver: Receiver) -> UdpLink:
    """Open a socket to `host`.

    Raises:
        OSError: there is no such host, or no way to it.
    """
    loop = asyncio.get_running_loop()
    _, link = await loop.create_datagram_endpoint(lambda: UdpLink(receiver), remote_addr=(host, port))
    return link
