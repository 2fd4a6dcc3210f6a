"""Observations: what was captured, when, and in which conversation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, Malformed


class Transport(StrEnum):
    """Transport protocol of a conversation."""

    UDP = "udp"
    TCP = "tcp"
    UNKNOWN = "unknown"
    """Pasted text does not show its transport."""


class Direction(StrEnum):
    """Direction of a frame. The frame itself does not show it; it follows from where the controller is."""

    REQUEST = "request"
    RESPONSE = "response"


class Endpoint(NamedTuple):
    """IP address as text, and port; port 0 if it is unknown."""

    host: str
    port: int

    def __str__(self) -> str:
        if not self.port:
            return self.host
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class ConnectionEnd:
    """The first end of a TCP connection.

    Attributes:
        by: Direction whose sender ended it: the client for requests, the controller for responses.
        reset: Whether RST ended it; otherwise FIN closed it in order, and the other end may still send.
        time: Time of the end, ns since 1970-01-01 UTC.
        both_ended: Whether the other end has closed it too, or either end has reset it since.
    """

    by: Direction
    reset: bool
    time: int
    both_ended: bool = False

    @property
    def ends_replies(self) -> bool:
        """Whether no reply can follow. If only the client closed with FIN, the controller may still reply."""
        return self.reset or self.both_ended or self.by is Direction.RESPONSE


class Conversation:
    """One client and one controller over one transport; compared by identity.

    A TCP conversation is one connection. A later connection between the same endpoints is another
    conversation.

    Attributes:
        server_known_by: Why `server` counts as the server, as text for the user: "port 5007", or the
            evidence in the traffic.
        connection_end: End of the TCP connection as far as seen; None while it is open, and for UDP.
    """

    def __init__(
        self, client: Endpoint, server: Endpoint, transport: Transport, server_known_by: str
    ) -> None:
        self.client = client
        self.server = server
        self.transport = transport
        self.server_known_by = server_known_by
        self.connection_end: ConnectionEnd | None = None

    def record_end(self, by: Direction, reset: bool, time: int) -> None:
        """Record that an end closed or reset the connection. The first end stays recorded."""
        if self.connection_end is None:
            self.connection_end = ConnectionEnd(by, reset, time)
        elif reset or by is not self.connection_end.by:
            self.connection_end = replace(self.connection_end, both_ended=True)

    def __repr__(self) -> str:
        return f"Conversation({self.client} > {self.server} {self.transport})"


class Flow:
    """One direction of a conversation, with its endpoints as ready-made text for output."""

    def __init__(self, conversation: Conversation, direction: Direction) -> None:
        ends = (conversation.client, conversation.server)
        self.conversation = conversation
        self.direction = direction
        self.src, self.dst = ends if direction is Direction.REQUEST else ends[::-1]
        self.src_text, self.dst_text = str(self.src), str(self.dst)

    def __repr__(self) -> str:
        return f"Flow({self.src_text} > {self.dst_text} {self.conversation.transport} {self.direction})"


class Observation(NamedTuple):
    """A frame, or bytes that are no frame, captured at one point.

    Attributes:
        number: 1 for the first item of the traffic; damaged items are numbered as well.
        time: Time of the last byte, ns since 1970-01-01 UTC.
        first_byte_time: Time of the first byte; differs from `time` only if a stream split the frame.
        packet: Number of the captured packet that completed it, from 1 over all packets of the source; 0
            without a capture.
    """

    number: int
    time: int
    first_byte_time: int
    flow: Flow
    item: Frame | Malformed
    packet: int
