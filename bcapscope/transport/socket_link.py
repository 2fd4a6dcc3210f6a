"""Base class of links over an asyncio socket."""

from __future__ import annotations

import asyncio
from typing import Generic, TypeVar

from bcapscope.transport.peer_link import Address, LinkReceiver

T = TypeVar("T", bound=asyncio.BaseTransport)


class SocketLink(asyncio.BaseProtocol, Generic[T]):
    """This end of a socket connected to its peer; passes events to the receiver until `close`.

    Attributes:
        end_reason: Reason passed to `on_link_lost` if the link ended without an error.
    """

    end_reason = "the socket was closed"

    def __init__(self, receiver: LinkReceiver) -> None:
        self._receiver: LinkReceiver | None = receiver
        self._transport: T | None = None

    @property
    def local(self) -> Address:
        return self._address("sockname")

    @property
    def peer(self) -> Address:
        """Address of the other end."""
        return self._address("peername")

    def close(self) -> None:
        """Close the socket; a stream still sends what was written to it."""
        self._receiver = None
        if self._transport is not None:
            self._transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.on_link_lost(
                self.end_reason if exc is None else f"the connection broke: {os_error_text(exc)}"
            )

    def _address(self, which: str) -> Address:
        assert self._transport is not None
        host, port, *_ = self._transport.get_extra_info(which)
        return host, port


def os_error_text(error: Exception) -> str:
    """Return the operating system's error text in lower case."""
    return str(error.strerror if isinstance(error, OSError) and error.strerror else error).lower()
