"""One thing seen on the wire: what, when, and between whom."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame, Malformed


class Transport(StrEnum):
    """What carried the frame."""

    UDP = "udp"
    TCP = "tcp"
    UNKNOWN = "unknown"
    """Text that was pasted tells nothing of it."""


class Direction(StrEnum):
    """Who spoke: nothing inside a frame tells it, only where the server is."""

    REQUEST = "request"
    RESPONSE = "response"


class Endpoint(NamedTuple):
    """An IP address as text and a port; port 0 where there is none to tell."""

    host: str
    port: int

    def __str__(self) -> str:
        if not self.port:
            return self.host
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class ConnectionEnd:
    """How a TCP connection ended first.

    Attributes:
        by: which end did it: that of the requests is the client.
        reset: broken off by RST; otherwise closed in order by FIN, after which the other end may say more.
        time: when, nanoseconds since 1970-01-01 UTC.
        both_ended: the other end has closed it since, too, or one has broken it off.
    """

    by: Direction
    reset: bool
    time: int
    both_ended: bool = False

    @property
    def ends_replies(self) -> bool:
        """Whether no reply can come any more: of a client that closed in order the other end may go on."""
        return self.reset or self.both_ended or self.by is Direction.RESPONSE


class Conversation:
    """One client talking to one server over one transport; compared by identity.

    A TCP conversation is one connection: a later connection between the same endpoints is another.

    Attributes:
        client: the end that asks.
        server: the end that answers.
        transport: UDP or TCP.
        server_known_by: why `server` is held to be the server, in words for the user: "port 5007", or
            what in the traffic told it.
        connection_end: how its connection ended, as far as was seen by now; None for one that is open, and
            over UDP.
    """

    __slots__ = ("client", "connection_end", "server", "server_known_by", "transport")

    def __init__(
        self, client: Endpoint, server: Endpoint, transport: Transport, server_known_by: str
    ) -> None:
        self.client = client
        self.server = server
        self.transport = transport
        self.server_known_by = server_known_by
        self.connection_end: ConnectionEnd | None = None

    def record_end(self, by: Direction, reset: bool, time: int) -> None:
        """Note that an end closed the connection, or broke it off; who did it first is kept."""
        if self.connection_end is None:
            self.connection_end = ConnectionEnd(by, reset, time)
        elif reset or by is not self.connection_end.by:
            self.connection_end = replace(self.connection_end, both_ended=True)

    def __repr__(self) -> str:
        return f"Conversation({self.client} > {self.server} {self.transport})"


class Flow:
    """One direction of a conversation, with the texts that every line about it needs ready made."""

    __slots__ = ("conversation", "direction", "dst", "dst_text", "src", "src_text")

    def __init__(self, conversation: Conversation, direction: Direction) -> None:
        ends = (conversation.client, conversation.server)
        self.conversation = conversation
        self.direction = direction
        self.src, self.dst = ends if direction is Direction.REQUEST else ends[::-1]
        self.src_text, self.dst_text = str(self.src), str(self.dst)

    def __repr__(self) -> str:
        return f"Flow({self.src_text} > {self.dst_text} {self.conversation.transport} {self.direction})"


class Observation(NamedTuple):
    """A frame, or bytes that are none, as seen at one place.

    Attributes:
        number: 1 for the first item of the traffic; every item has one, sound or not.
        time: when its last byte was seen, nanoseconds since 1970-01-01 UTC.
        first_byte_time: when its first byte was seen; equal to `time` unless a stream cut the frame.
        flow: who spoke to whom.
        item: the frame, or the bytes that are none.
        packet: number of the captured packet that completed it, from 1 over all packets of the source;
            0 where there was no capture.
    """

    number: int
    time: int
    first_byte_time: int
    flow: Flow
    item: Frame | Malformed
    packet: int
