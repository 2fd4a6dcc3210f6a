"""Interfaces that all transports share: a link to one peer, and the receiver of its data."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from bcapscope.messages import Message

Address: TypeAlias = tuple[str, int]
"""IP address as text, and port."""


class LinkReceiver(Protocol):
    """Receives the events of a link; none of the methods may raise."""

    def on_data(self, data: bytes) -> None:
        """Process a datagram, or the next bytes of a stream."""

    def on_send_error(self, reason: Message) -> None:
        """Process the system's error for data that was sent; the link remains open."""

    def on_link_lost(self, reason: Message) -> None:
        """Process the loss of the link; no data follows."""


class BaseLink(Protocol):
    """A link to one peer; implementations decide how the caller gets received data.

    Attributes:
        datagrams: True if each message arrives whole, zero, one or several times; False for a stream.
        local: Address of this end.
        peer: Address of the other end.
    """

    @property
    def datagrams(self) -> bool: ...

    @property
    def local(self) -> Address: ...

    @property
    def peer(self) -> Address: ...

    def send(self, data: bytes) -> None:
        """Send at once; never waits.

        Raises:
            OSError: The data cannot be sent, and the link has no `LinkReceiver` for the error.
        """

    def close(self) -> None:
        """Close the link; may be called again."""


class Link(BaseLink, Protocol):
    """A link to one peer that passes received data to a `LinkReceiver` until `close`."""
