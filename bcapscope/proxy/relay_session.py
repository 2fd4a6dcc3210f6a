"""Interfaces and addresses of the relay's clients: sessions, listeners and endpoints."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import msgspec

from bcapscope.proxy.admission import Occupant
from bcapscope.traffic.observation import Conversation, Endpoint, Transport


class RelaySession(Occupant, Protocol):
    """The relay's session with one client: it forwards between the client and the controller.

    Attributes:
        conversation: Conversation between the client and the controller, as if there were no proxy.
        last_heard: Value of `Relay.now` when the client last sent something.
    """

    conversation: Conversation
    last_heard: int

    @property
    def upstream_state(self) -> str:
        """State of the connection to the controller: open, connecting, connected, half-open or refused."""

    def send(self, up: bool, data: bytes) -> int:
        """Send data up or down. Return the time in ns since 1970; 0 if some of the data was not sent yet."""

    def on_nothing_held(self, up: bool) -> None:
        """Continue after rules have released all data of a direction."""

    def resume_reading(self) -> None:
        """Read from the client again, after rules held too much data."""

    def sweep(self, now: int) -> None:
        """Do the periodic work; `now` is the value of `Relay.now`."""


class ClientListener(Protocol):
    """A socket that accepts clients."""

    def open(self) -> None:
        """Start to accept clients."""

    def close(self) -> None:
        """Accept no more clients."""

    def release(self) -> None:
        """Release the socket after `close`, when no session is left."""

    def sweep(self, now: int) -> None:
        """Do the periodic work; `now` is the value of `Relay.now`."""


class ClientEndpoints(NamedTuple):
    """Addresses of the two connections of a client: to the proxy, and from the proxy to the controller.

    Attributes:
        listen: Address of the proxy to which the client sends.
        upstream: Address of the proxy from which it sends to the controller.
    """

    transport: Transport
    client: Endpoint
    listen: Endpoint
    upstream: Endpoint
    controller: Endpoint

    def to_json(self) -> bytes:
        """Return the data of a `CLIENT_OPENED` record."""
        return msgspec.json.encode(self)


_decoder = msgspec.json.Decoder(ClientEndpoints)


def read_endpoints(data: bytes) -> ClientEndpoints:
    """Decode the data of a `CLIENT_OPENED` record."""
    return _decoder.decode(data)
