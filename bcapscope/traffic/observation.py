"""Observations: frames or damaged bytes, with the time and the conversation in which they were captured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

from bcapscope.protocol.codec.frame import Frame, Malformed

if TYPE_CHECKING:
    from bcapscope.traffic.joining.place_merger import CaptureSide


class Transport(StrEnum):
    """Transport protocol of a conversation."""

    UDP = "udp"
    TCP = "tcp"
    UNKNOWN = "unknown"
    """The transport of frames in pasted text is unknown."""


class Direction(StrEnum):
    """Direction of a frame, inferred from the controller's address, because no field shows it."""

    REQUEST = "request"
    RESPONSE = "response"


class ServerEvidenceKind(StrEnum):
    """How bcapscope knows which end of a conversation is the controller."""

    PORT = "port"
    """Only one end has a port on which controllers listen."""
    PARTICIPANT = "participant"
    """bcapscope is the proxy, the client or the simulator of the conversation, and sees each stream from its
    beginning."""
    TEXT = "text"
    """The frames are from pasted text, which has no addresses."""
    HANDSHAKE = "handshake"
    """The controller accepted the TCP connection."""
    RESULT = "result"
    """One end sent a frame whose code can only be a result code."""
    CALL = "call"
    """The client sent a request whose arguments fit its function."""
    GUESS = "guess"
    """bcapscope assumes that the client sent first, because no frame shows which end is the controller."""


class ServerEvidence(NamedTuple):
    """Evidence of which end is the controller. `code` is a result code, a function id, or 0."""

    kind: ServerEvidenceKind
    code: int = 0


SERVER_PORT = ServerEvidence(ServerEvidenceKind.PORT)
SERVER_PARTICIPANT = ServerEvidence(ServerEvidenceKind.PARTICIPANT)


class Endpoint(NamedTuple):
    """IP address (as text) and port number. The port is 0 if it is unknown."""

    host: str
    port: int

    def __str__(self) -> str:
        if not self.port:
            return self.host
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class ConnectionEnd:
    """How and when a TCP connection was first closed or reset.

    Attributes:
        by: Direction of the packet that ended the connection: `REQUEST` if the client ended it.
        reset: True for RST, False for FIN, after which the other end may still send.
        time: Time of the first RST or FIN, ns since 1970-01-01 UTC.
        both_ended: Whether both ends closed the connection, or one end reset the connection after a FIN.
    """

    by: Direction
    reset: bool
    time: int
    both_ended: bool = False

    @property
    def ends_replies(self) -> bool:
        """Whether the controller can no longer reply. If only the client sent a FIN, replies can follow."""
        return self.reset or self.both_ended or self.by is Direction.RESPONSE


@dataclass(eq=False, repr=False)
class Conversation:
    """The traffic of one client and one controller over one transport.

    Conversations are compared by identity.

    A TCP conversation is one connection. A later connection between the same endpoints is another
    conversation.

    Attributes:
        client: Address and port of the client.
        server: Address and port of the controller.
        server_evidence: Evidence that `server` is the controller.
        connection_end: End of the TCP connection, as far as captured; None while the connection is open, and
            for UDP.
        interface: Name of the interface on which the conversation was captured; "" if the capture names none.
        controller_leg: For the leg between client and proxy, the conversation of the leg between proxy and
            controller; None for any other conversation, or if the capture lacks the second leg.
        capture_side: Place at which the conversation was captured; None unless two captures hold the same
            conversation.
        joined_as: Conversation to which a joiner assigns the frames of this conversation; None if this
            conversation keeps its frames. `record_end` also updates `connection_end` of `joined_as`.
    """

    client: Endpoint
    server: Endpoint
    transport: Transport
    server_evidence: ServerEvidence
    connection_end: ConnectionEnd | None = None
    interface: str = ""
    controller_leg: Conversation | None = None
    capture_side: CaptureSide | None = None
    joined_as: Conversation | None = None

    def record_end(self, by: Direction, reset: bool, time: int) -> None:
        """Record that the client or the controller closed or reset the connection. Later events are
        ignored."""
        if self.connection_end is None:
            self.connection_end = ConnectionEnd(by, reset, time)
        elif reset or by is not self.connection_end.by:
            self.connection_end = replace(self.connection_end, both_ended=True)
        if self.joined_as is not None:
            self.joined_as.connection_end = self.connection_end

    def __repr__(self) -> str:
        return f"Conversation({self.client} > {self.server} {self.transport})"


class Flow:
    """One direction of a conversation, with its endpoints and their text for output."""

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
        number: Number of the observation in the traffic, counted from 1. Damaged frames have numbers too.
        time: Capture time of the last byte, ns since 1970-01-01 UTC.
        first_byte_time: Capture time of the first byte, ns since 1970-01-01 UTC; equal to `time` unless the
            TCP stream split the frame.
        packet: Number of the captured packet that contains the last byte; 0 if the frame is not from a
            capture. All packets of a capture are counted, from 1.
    """

    number: int
    time: int
    first_byte_time: int
    flow: Flow
    item: Frame | Malformed
    packet: int
