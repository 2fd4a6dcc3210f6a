"""What the relay knows of its clients: their sessions, their addresses, and the sockets that accept them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import msgspec

from bcapscope.proxy.admission import Occupant
from bcapscope.traffic.observation import Conversation, Endpoint, Transport


class RelaySession(Occupant, Protocol):
    """The forwarding for one client.

    Attributes:
        conversation: Conversation between the client and the controller, without the proxy.
        last_heard: `Relay.now` when the client last sent something.
    """

    conversation: Conversation
    last_heard: int

    @property
    def upstream_state(self) -> str:
        """State of the connection to the controller: open, connecting, connected, half-open, refused."""

    def send(self, up: bool, data: bytes) -> int:
        """Send data up or down. Return when, in ns since 1970; 0 if not all of it was sent yet."""

    def on_nothing_held(self, up: bool) -> None:
        """React to the fact that rules hold nothing of a direction any more."""

    def resume_reading(self) -> None:
        """Read again after rules held too much."""

    def sweep(self, now: int) -> None:
        """Do the periodic work; `now` as `Relay.now`."""


class ClientListener(Protocol):
    """A socket that accepts clients."""

    def open(self) -> None:
        """Start to accept clients."""

    def close(self) -> None:
        """Accept no more clients."""

    def release(self) -> None:
        """Release the socket. Call `close` first; no session may be left."""

    def sweep(self, now: int) -> None:
        """Do the periodic work; `now` as `Relay.now`."""


class ClientEndpoints(NamedTuple):
    """Addresses of a client's two connections.

    Attributes:
        transport: UDP or TCP.
        client: Address of the client.
        listen: Address that the client sends to.
        upstream: Address of the proxy toward the controller.
        controller: Address of the controller.
    """

    transport: Transport
    client: Endpoint
    listen: Endpoint
    upstream: Endpoint
    controller: Endpoint

    def to_json(self) -> bytes:
        """Return the data of a record of the kind `CLIENT_OPENED`."""
        return msgspec.json.encode(self)


_decoder = msgspec.json.Decoder(ClientEndpoints)


def read_endpoints(data: bytes) -> ClientEndpoints:
    """Read the data of a record of the kind `CLIENT_OPENED`."""
    return _decoder.decode(data)
