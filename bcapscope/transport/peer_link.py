"""Interfaces that all transports share: a link to one peer, and the receiver of the data from this peer."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from bcapscope.messages import Message

Address: TypeAlias = tuple[str, int]
"""IP address as text, and port."""


class LinkReceiver(Protocol):
    """Receives the events of a link. None of its methods may raise an exception."""

    def on_data(self, data: bytes) -> None:
        """Process a datagram, or the next bytes of a stream."""

    def on_send_error(self, reason: Message) -> None:
        """Process an error that the operating system reports for sent data; the link remains open."""

    def on_link_lost(self, reason: Message) -> None:
        """Process the loss of the link, after which no data can arrive."""


class Link(Protocol):
    """A link to one peer. With `datagrams`, data may get lost or repeated; otherwise the link is a stream."""

    @property
    def datagrams(self) -> bool: ...

    @property
    def local(self) -> Address: ...

    @property
    def peer(self) -> Address: ...

    def send(self, data: bytes) -> None:
        """Send data without waiting. Raises OSError only if the link has no `LinkReceiver`."""

    def close(self) -> None:
        """Close the link; a second call does nothing."""
