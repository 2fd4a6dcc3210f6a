"""UDP to one peer."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterable
from typing import Any, TypeAlias, cast

from bcapscope.transport.peer_link import LinkReceiver
from bcapscope.transport.socket_link import SocketLink, os_error_text

AddressInfo: TypeAlias = tuple[int, int, int, str, Any]
"""As `socket.getaddrinfo` tells an address."""


def preferred_address(addresses: Iterable[AddressInfo]) -> AddressInfo:
    """Choose one of a host's addresses: that of IPv4, which controllers have, where there is one.

    Over UDP a wrong choice looks like a controller that does not answer; names such as localhost often have
    an address of IPv6 before it.
    """
    return min(addresses, key=lambda each: each[0] != socket.AF_INET)


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
            self._receiver.on_data(data)

    def error_received(self, exc: Exception) -> None:
        if self._receiver is not None:
            self._receiver.on_send_error(os_error_text(exc))


async def open_udp(host: str, port: int, receiver: LinkReceiver) -> UdpLink:
    """Open a socket to `host`.

    Raises:
        OSError: there is no such host, or no way to it.
    """
    loop = asyncio.get_running_loop()
    family, *_ = preferred_address(await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))
    _, link = await loop.create_datagram_endpoint(
        lambda: UdpLink(receiver), remote_addr=(host, port), family=family
    )
    return link
