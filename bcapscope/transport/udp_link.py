"""A UDP link to one peer."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterable
from typing import Any, TypeAlias, cast

from bcapscope.messages.os_errors import os_reason
from bcapscope.transport.peer_link import LinkReceiver
from bcapscope.transport.socket_link import SocketLink

AddressInfo: TypeAlias = tuple[int, int, int, str, Any]
"""One address in the form of `socket.getaddrinfo`."""


def preferred_address(addresses: Iterable[AddressInfo]) -> AddressInfo:
    """Return the first IPv4 address of a host; without IPv4 address, the first address. Controllers use IPv4.

    Over UDP a wrong choice looks like a controller that does not answer. Names such as localhost often list
    an IPv6 address first.
    """
    return min(addresses, key=lambda each: each[0] != socket.AF_INET)


class UdpLink(SocketLink[asyncio.DatagramTransport], asyncio.DatagramProtocol):
    """A connected UDP socket: the system drops datagrams of other senders and reports closed ports."""

    datagrams = True

    def send(self, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # The cast is necessary because asyncio's own class is not a DatagramTransport before Python 3.12.
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        if self._receiver is not None:
            self._receiver.on_data(data)

    def error_received(self, exc: Exception) -> None:
        if self._receiver is not None:
            self._receiver.on_send_error(os_reason(exc))


async def open_udp(host: str, port: int, receiver: LinkReceiver) -> UdpLink:
    """Open a socket connected to `host` and return the link.

    Raises:
        OSError: The host is unknown or unreachable.
    """
    loop = asyncio.get_running_loop()
    family, *_ = preferred_address(await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))
    _, link = await loop.create_datagram_endpoint(
        lambda: UdpLink(receiver), remote_addr=(host, port), family=family
    )
    return link
