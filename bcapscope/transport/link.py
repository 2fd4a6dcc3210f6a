"""What all transports have in common: a link to one peer, and who is told what comes over it."""

from __future__ import annotations

from typing import Protocol, TypeAlias

Address: TypeAlias = tuple[str, int]
"""IP address as text, and port."""


class Receiver(Protocol):
    """Is told what happens on a link; none of the methods may raise."""

    def received(self, data: bytes) -> None:
        """Take a datagram, or the next bytes of a stream."""

    def trouble(self, text: str) -> None:
        """Take what the system says of what was sent; the link is still there."""

    def lost(self, reason: str) -> None:
        """Take notice that the link is gone and nothing will come any more."""


class Link(Protocol):
    """A way to one peer.

    Attributes:
        datagrams: what is sent arrives whole, several times or not at all; else a stream.
        local: our end.
        peer: the other end.
    """

    @property
    def datagrams(self) -> bool: ...

    @property
    def local(self) -> Address: ...

    @property
    def peer(self) -> Address: ...

    def send(self, data: bytes) -> None:
        """Send at once; never waits."""

    def close(self) -> None:
        """Let go; the receiver hears nothing any more. May be called again."""
