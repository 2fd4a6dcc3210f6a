"""The faults, as validated immutable data.

Names are those of Linux tc-netem(8) and of Shopify's toxiproxy, if these programs have one. A fault specifies
which messages it hits and what happens to them. Each fault has its own stream of random numbers. A message is
a datagram. On TCP, a message is a frame, or a run of bytes that are not a frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, ClassVar, TypeAlias, get_args

import msgspec
from msgspec import Meta

from bcapscope.errors import InputError
from bcapscope.faults.quantities import (
    LARGEST_END,
    DurationQuantity,
    FrameCondition,
    HresultQuantity,
    Rate,
    Share,
    Span,
    read_path,
)
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import LARGEST_FRAME
from bcapscope.traffic.observation import Direction

MS = 1_000_000
MAX_NOTICES = 10_000

Count: TypeAlias = Annotated[int, Meta(ge=1, le=1_000_000)]
UInt16: TypeAlias = Annotated[int, Meta(ge=0, le=0xFFFF)]
RewriteValue: TypeAlias = int | float | bool | str

ALWAYS, NEVER = Share(1), Share(0)


class JitterDistribution(StrEnum):
    """Distribution of the jitter of a delay."""

    UNIFORM = "uniform"
    """Evenly within ± the jitter."""
    NORMAL = "normal"
    """The jitter is the standard deviation."""
    PARETO = "pareto"
    """The jitter is the scale of a tail with exponent 3: most delays are short, and a few are very long."""


class CloseMode(StrEnum):
    """How a TCP connection is closed."""

    RESET = "reset"
    """Close with RST, at once."""
    FIN = "fin"
    """Close with FIN, after all bytes were sent."""


class Fault(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag_field="action",
    rename={"when": "if", "lasts": "for", "attempt": "try"},
):
    """Fields of all faults, which select the messages that the fault hits.

    Attributes:
        name: Name for reports, and seed of the random numbers: letters, digits and ``_ . + -``. An empty name
            is replaced by a generated one.
        when: Filter that a message must match; `when` is written as ``if``.
        direction: Direction of the messages to hit; None for both directions.
        probability: Share of the messages to hit, among those that fulfil all other conditions.
        times: Number of hits after which the fault ends; None for no limit.
        after: Time from the setup of the fault to its start.
        lasts: Time from the start to the end of the fault; None for no end; `lasts` is written as ``for``.
        attempt: Attempt of a call to hit, or whose response to hit; 1 is the first, None is any; `attempt` is
            written as ``try``.
    """

    name: Annotated[str, Meta(pattern=r"^[\w.+-]{0,60}$")] = ""
    when: FrameCondition | None = None
    direction: Direction | None = None
    probability: Share = ALWAYS
    times: Count | None = None
    after: DurationQuantity = DurationQuantity(0)
    lasts: DurationQuantity | None = None
    attempt: Count | None = None

    needs_whole_frame: ClassVar[bool] = False
    """Whether the action needs whole frames, regardless of the conditions."""

    @property
    def action(self) -> str:
        return str(self.__struct_config__.tag)

    @property
    def needs_frames(self) -> bool:
        """Whether a stream must be split into frames for this fault."""
        return (
            self.needs_whole_frame
            or self.when is not None
            or self.attempt is not None
            or self.probability < 1
        )


class PassFault(Fault, frozen=True, kw_only=True, tag="pass"):
    """Forward the message and skip all later faults."""


class DropFault(Fault, frozen=True, kw_only=True, tag="drop"):
    """Drop the message."""

    needs_whole_frame: ClassVar[bool] = True


class BurstFault(Fault, frozen=True, kw_only=True, tag="burst"):
    """Drop messages in bursts, with the Gilbert-Elliott model, separately for each direction.

    Attributes:
        enter: Probability per message of a change from the good state to the bad state.
        leave: Probability per message of a change from the bad state to the good state.
        bad: Share of the messages that are dropped in the bad state.
        good: Share of the messages that are dropped in the good state.
    """

    enter: Share
    leave: Share
    bad: Share = ALWAYS
    good: Share = NEVER

    needs_whole_frame: ClassVar[bool] = True


class DelayFault(Fault, frozen=True, kw_only=True, tag="delay"):
    """Forward the message later. Other datagrams may overtake a datagram; bytes of a stream stay in order.

    Attributes:
        time: Delay without jitter.
        jitter: Variation of the delay. The sum of delay and jitter is never negative.
    """

    time: DurationQuantity
    jitter: DurationQuantity = DurationQuantity(0)
    distribution: JitterDistribution = JitterDistribution.UNIFORM


class DuplicateFault(Fault, frozen=True, kw_only=True, tag="duplicate"):
    """Send the message several times.

    Attributes:
        copies: Number of copies that are sent besides the message itself.
        time: Time between a copy and the next copy.
    """

    copies: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: DurationQuantity = DurationQuantity(0)

    needs_whole_frame: ClassVar[bool] = True


class ReorderFault(Fault, frozen=True, kw_only=True, tag="reorder"):
    """Let later messages overtake the message. On TCP, the controller then seems to reply out of order.

    Attributes:
        by: Number of messages that overtake this message.
        time: Maximum time that the message waits for these messages.
    """

    by: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: DurationQuantity = DurationQuantity(100 * MS)

    needs_whole_frame: ClassVar[bool] = True


class CorruptFault(Fault, frozen=True, kw_only=True, tag="corrupt"):
    """Flip bits of the message.

    Attributes:
        bits: Number of random flips. Two flips may hit the same bit and so restore it.
        offset: Offset of the byte whose bits are flipped; None for any byte.
    """

    bits: Annotated[int, Meta(ge=1, le=10_000)] = 1
    offset: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class TruncateFault(Fault, frozen=True, kw_only=True, tag="truncate"):
    """Cut off the end of the message.

    Attributes:
        keep: Number of bytes to keep; None for a random number.
    """

    keep: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class GarbageFault(Fault, frozen=True, kw_only=True, tag="garbage"):
    """Replace the message by random bytes. By default, only responses are hit.

    Attributes:
        size: Number of bytes to send; None for the size of the message.
    """

    direction: Direction | None = Direction.RESPONSE
    size: Annotated[int, Meta(ge=1, le=65507)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class RewriteFault(Fault, frozen=True, kw_only=True, tag="rewrite"):
    """Change numbers in the frame. If nothing changes, the bytes stay as received.

    Attributes:
        code: New function id of a request, or new HRESULT of a response.
        set: New values of arguments or elements: ``{"arg[2][0]": 10}``. A value keeps its type unless the
            text names another: ``r4:10``.
        limit: Spans for numbers. A number outside its span becomes the nearest end of the span. The span of
            an array applies to every element.
        step: Largest change of a number from one message to the next similar message of the conversation.
    """

    serial: UInt16 | None = None
    reserved: UInt16 | None = None
    code: HresultQuantity | None = None
    set: dict[str, RewriteValue] = {}
    limit: dict[str, Span] = {}
    step: dict[str, Annotated[float, Meta(gt=0, le=LARGEST_END)]] = {}

    needs_whole_frame: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.serial is self.reserved is self.code is None and not (self.set or self.limit or self.step):
            raise InputError(Message("fault.rewrite-nothing"))
        for path in (*self.set, *self.limit, *self.step):
            read_path(path)


class SerialFault(Fault, frozen=True, kw_only=True, tag="serial"):
    """Add a number to the serial of the frame. By default, only responses are hit.

    Attributes:
        by: Number that is added to the serial.
    """

    direction: Direction | None = Direction.RESPONSE
    by: Annotated[int, Meta(ge=-65535, le=65535)] = 1

    needs_whole_frame: ClassVar[bool] = True


class AnswerFault(Fault, frozen=True, kw_only=True, tag="answer"):
    """Answer a request with the result code `hresult` and no value, and do not forward the request.

    With direction `response`, the request is forwarded, and the result code replaces the controller's reply.
    """

    direction: Direction | None = Direction.REQUEST
    hresult: HresultQuantity

    needs_whole_frame: ClassVar[bool] = True


class ExecutingFault(Fault, frozen=True, kw_only=True, tag="executing"):
    """Send S_EXECUTING to the client for a while, then forward the message. By default, only responses are
    hit.

    Attributes:
        time: Time during which the notices are sent.
        every: Time between two notices. The first notice is sent at once.
    """

    direction: Direction | None = Direction.RESPONSE
    time: DurationQuantity
    every: DurationQuantity = DurationQuantity(100 * MS)

    needs_whole_frame: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.every < MS:
            raise InputError(Message("fault.notices-often"))
        if self.time > self.every * MAX_NOTICES:
            raise InputError(Message("fault.notices-many", limit=MAX_NOTICES))


class CloseFault(Fault, frozen=True, kw_only=True, tag="close"):
    """Close both sides of the client's TCP connection, and drop the message. UDP is not affected.

    Attributes:
        how: Close with RST at once, or with FIN after the messages that other faults hold.
    """

    how: CloseMode = CloseMode.RESET

    needs_whole_frame: ClassVar[bool] = True


class BandwidthFault(Fault, frozen=True, kw_only=True, tag="bandwidth"):
    """Limit the bandwidth, separately for each direction.

    Attributes:
        queue: Number of bytes that may wait. Beyond it, datagrams are dropped. Bytes of a stream wait without
            limit.
    """

    rate: Rate
    queue: Annotated[int, Meta(ge=1, le=1 << 30)] = 256 * 1024


class PartitionFault(Fault, frozen=True, kw_only=True, tag="partition"):
    """Let no message pass. Datagrams are dropped. Bytes of a stream arrive when the partition ends.

    The bytes of the stream arrive as if sent again. If the partition has no end, the bytes are dropped too.
    """


class HalfOpenFault(Fault, frozen=True, kw_only=True, tag="half-open"):
    """Block the conversation in both directions for good, and hide its end from both sides."""


AnyFault: TypeAlias = (
    PassFault
    | DropFault
    | BurstFault
    | DelayFault
    | DuplicateFault
    | ReorderFault
    | CorruptFault
    | TruncateFault
    | GarbageFault
    | RewriteFault
    | SerialFault
    | AnswerFault
    | ExecutingFault
    | CloseFault
    | BandwidthFault
    | PartitionFault
    | HalfOpenFault
)
"""Union of all faults. In a document, `action` selects the class."""

ACTIONS: Mapping[str, type[Fault]] = MappingProxyType(
    {str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)}
)

ALIASES: Mapping[str, str] = MappingProxyType({"loss": "drop"})
"""Other names of actions, as in tc-netem(8). A fault with such a name needs its main value."""
