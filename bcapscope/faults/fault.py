"""The faults, as validated immutable data.

Names are those of Linux tc-netem(8) and of Shopify's toxiproxy where they have one. A fault specifies which
messages it hits and what happens to them. Each fault has its own stream of random numbers. A message is a
datagram. On TCP it is a frame, or a run of bytes that are no frame.
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
    """How the jitter spreads around the delay."""

    UNIFORM = "uniform"
    """Evenly within ± the jitter."""
    NORMAL = "normal"
    """The jitter is the standard deviation."""
    PARETO = "pareto"
    """Mostly short and rarely very long: the jitter is the scale of a tail with exponent 3."""


class CloseMode(StrEnum):
    """How a TCP connection is closed."""

    RESET = "reset"
    """At once, with RST."""
    FIN = "fin"
    """In order, with FIN."""


class Fault(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag_field="action",
    rename={"when": "if", "lasts": "for", "attempt": "try"},
):
    """Fields of all faults, which select the messages to hit.

    Attributes:
        name: Name for reports, and seed of the random numbers: letters, digits and ``_ . + -``. If empty, a
            name is generated.
        when: Filter that the message must match; written ``if``.
        direction: Only requests or only responses; None for both.
        probability: Share of the otherwise matching messages to hit.
        times: Number of hits after which the fault ends; None for no limit.
        after: Time from setup to the start of the fault.
        lasts: Time from the start to the end of the fault; None for no end. Written ``for``.
        attempt: Only the n-th attempt of a call, or the response to it; 1 is the first. Written ``try``.
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
    """Whether the action itself needs whole frames, regardless of the conditions."""

    @property
    def action(self) -> str:
        """Name of the action in files and on the command line."""
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
    """Lose the message."""

    needs_whole_frame: ClassVar[bool] = True


class BurstFault(Fault, frozen=True, kw_only=True, tag="burst"):
    """Lose messages in bursts, with the Gilbert-Elliott model, separately for each direction.

    Attributes:
        enter: Probability, per message, that the good state turns bad.
        leave: Probability, per message, that the bad state turns good.
        bad: Share of messages lost in the bad state.
        good: Share of messages lost in the good state.
    """

    enter: Share
    leave: Share
    bad: Share = ALWAYS
    good: Share = NEVER

    needs_whole_frame: ClassVar[bool] = True


class DelayFault(Fault, frozen=True, kw_only=True, tag="delay"):
    """Forward the message later. Datagrams may overtake it; bytes of a stream never do.

    Attributes:
        time: Delay without jitter.
        jitter: Variation of the delay; the result is never negative.
        distribution: Distribution of the jitter.
    """

    time: DurationQuantity
    jitter: DurationQuantity = DurationQuantity(0)
    distribution: JitterDistribution = JitterDistribution.UNIFORM


class DuplicateFault(Fault, frozen=True, kw_only=True, tag="duplicate"):
    """Send the message several times.

    Attributes:
        copies: Number of copies besides the message itself.
        time: Time between one copy and the next.
    """

    copies: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: DurationQuantity = DurationQuantity(0)

    needs_whole_frame: ClassVar[bool] = True


class ReorderFault(Fault, frozen=True, kw_only=True, tag="reorder"):
    """Let later messages overtake this one. On TCP too: the controller then appears to reply out of order.

    Attributes:
        by: Number of messages that go before it.
        time: Longest wait for them; then the message is sent.
    """

    by: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: DurationQuantity = DurationQuantity(100 * MS)

    needs_whole_frame: ClassVar[bool] = True


class CorruptFault(Fault, frozen=True, kw_only=True, tag="corrupt"):
    """Flip bits.

    Attributes:
        bits: Number of random flips. Two flips may hit the same bit and restore it.
        offset: Offset of the byte to hit; None for any byte.
    """

    bits: Annotated[int, Meta(ge=1, le=10_000)] = 1
    offset: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class TruncateFault(Fault, frozen=True, kw_only=True, tag="truncate"):
    """Cut off the end.

    Attributes:
        keep: Bytes to keep; None for a random number.
    """

    keep: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class GarbageFault(Fault, frozen=True, kw_only=True, tag="garbage"):
    """Replace the message by random bytes; by default only responses.

    Attributes:
        size: Bytes to send; None for the size of the message.
    """

    direction: Direction | None = Direction.RESPONSE
    size: Annotated[int, Meta(ge=1, le=65507)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class RewriteFault(Fault, frozen=True, kw_only=True, tag="rewrite"):
    """Change numbers in the frame. If nothing changes, the bytes stay as received.

    Attributes:
        serial: New serial.
        reserved: New reserved field.
        code: New function id of a request, or new HRESULT of a response.
        set: New values of arguments or elements: ``{"arg[2][0]": 10}``. A value keeps its type, unless the
            text names one: ``r4:10``.
        limit: Spans for numbers. A number outside its span is set to the nearest end; in an array, every
            element.
        step: Largest change of a number from one such message of a conversation to the next.
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
    """Change the serial of the frame; by default only of responses.

    Attributes:
        by: Number added to the serial.
    """

    direction: Direction | None = Direction.RESPONSE
    by: Annotated[int, Meta(ge=-65535, le=65535)] = 1

    needs_whole_frame: ClassVar[bool] = True


class AnswerFault(Fault, frozen=True, kw_only=True, tag="answer"):
    """Answer the client with a result code and no value, and do not forward its request.

    With direction `response`, the request is forwarded, and the result code replaces the controller's reply.

    Attributes:
        hresult: Result code.
    """

    direction: Direction | None = Direction.REQUEST
    hresult: HresultQuantity

    needs_whole_frame: ClassVar[bool] = True


class ExecutingFault(Fault, frozen=True, kw_only=True, tag="executing"):
    """Send S_EXECUTING to the client for a while, then forward the message; by default only a response.

    Attributes:
        time: Duration of the notices.
        every: Interval between two notices; the first is sent at once.
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
    """Close the client's TCP connection on both sides and lose the message. UDP is not affected.

    Attributes:
        how: Reset at once, or close in order after the messages that other faults hold.
    """

    how: CloseMode = CloseMode.RESET

    needs_whole_frame: ClassVar[bool] = True


class BandwidthFault(Fault, frozen=True, kw_only=True, tag="bandwidth"):
    """Limit the bandwidth, separately for each direction.

    Attributes:
        rate: Bandwidth of the line.
        queue: Bytes that may wait; beyond them datagrams are lost. Bytes of a stream wait without limit.
    """

    rate: Rate
    queue: Annotated[int, Meta(ge=1, le=1 << 30)] = 256 * 1024


class PartitionFault(Fault, frozen=True, kw_only=True, tag="partition"):
    """Let nothing through. Datagrams are lost; bytes of a stream arrive when the partition ends.

    They arrive as if sent again. If the partition has no end, they are lost too.
    """


class HalfOpenFault(Fault, frozen=True, kw_only=True, tag="half-open"):
    """Block this conversation in both directions for good, including its end."""


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
"""Every fault; `action` identifies its class in a document."""

ACTIONS: Mapping[str, type[Fault]] = MappingProxyType(
    {str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)}
)
"""Fault class by action."""

ALIASES: Mapping[str, str] = MappingProxyType({"loss": "drop"})
"""Other names of actions, as in netem. A fault written with an alias needs its main value."""
