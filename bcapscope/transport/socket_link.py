"""Base class of links over an asyncio socket."""

from __future__ import annotations

import asyncio
from typing import Generic, TypeVar

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.transport.peer_link import Address, LinkReceiver

T = TypeVar("T", bound=asyncio.BaseTransport)


class SocketLink(asyncio.BaseProtocol, Generic[T]):
    """A link over a connected socket, which passes events to the receiver until `close`.

    Attributes:
        end_reason: Message id of the reason for `on_link_lost` if the link ends without an error.
    """

    end_reason = "connection.socket-closed"

    def __init__(self, receiver: LinkReceiver) -> None:
        self._receiver: LinkReceiver | None = receiver
        self._transport: T | None = None

    @property
    def local(self) -> Address:
        return self._address("sockname")

    @property
    def peer(self) -> Address:
        return self._address("peername")

    def close(self) -> None:
        """Close the socket; a stream still sends the data written before."""
        self._receiver = None
        if self._transport is not None:
            self._transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.on_link_lost(
                Message(self.end_reason)
                if exc is None
                else Message("connection.broke", reason=os_reason(exc))
            )

    def _address(self, which: str) -> Address:
        assert self._transport is not None
        host, port, *_ = self._transport.get_extra_info(which)
        return host, port
