"""What all transports have in common: a way to one peer, and who is told what comes over it."""

from __future__ import annotations

from typing import Protocol, TypeAlias

Address: TypeAlias = tuple[str, int]
"""IP address as text, and port."""


class LinkReceiver(Protocol):
    """Is told what happens on a link; none of the methods may raise."""

    def on_data(self, data: bytes) -> None:
        """Take a datagram, or the next bytes of a stream."""

    def on_send_error(self, text: str) -> None:
        """Take what the system says of what was sent; the link is still there."""

    def on_link_lost(self, reason: str) -> None:
        """Take notice that the link is gone and nothing will come any more."""


class BaseLink(Protocol):
    """A way to one peer, however one learns what comes back.

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
        """Send at once; never waits.

        Raises:
            OSError: it cannot be sent, where nobody else could be told of that.
        """

    def close(self) -> None:
        """Let go; may be called again."""


class Link(BaseLink, Protocol):
    """A way to one peer; it hands what comes to a `LinkReceiver` until `close`."""
