"""The faults, as validated frozen data.

Words are those of Linux tc-netem(8) and of Shopify's toxiproxy where they have one. A fault says which
messages it strikes and what becomes of them; what it draws by lot comes from a stream of random numbers that
is its own. A message is a datagram, or of a TCP stream a frame (or a run of bytes that are none).
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, ClassVar, TypeAlias, get_args

import msgspec
from msgspec import Meta

from bcapscope.faults.quantities import (
    LARGEST_END,
    Duration,
    FrameCondition,
    HresultQuantity,
    Rate,
    Share,
    Span,
    read_path,
)
from bcapscope.protocol.codec.frame import LARGEST_FRAME
from bcapscope.traffic.observation import Direction

MS = 1_000_000
MAX_NOTICES = 10_000

Count: TypeAlias = Annotated[int, Meta(ge=1, le=1_000_000)]
UInt16: TypeAlias = Annotated[int, Meta(ge=0, le=0xFFFF)]
RewriteValue: TypeAlias = int | float | bool | str

ALWAYS, NEVER = Share(1), Share(0)


class JitterDistribution(StrEnum):
    """How a jitter is spread around the delay."""

    UNIFORM = "uniform"
    """All of it within the jitter."""
    NORMAL = "normal"
    """The jitter is the standard deviation."""
    PARETO = "pareto"
    """Mostly a little, now and then a lot: the jitter is the scale of a tail with exponent 3."""


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
    """What all faults have: which messages they strike.

    Attributes:
        name: for reports, and the seed of its random numbers: letters, digits and ``_ . + -``. One is made up
            where it is empty.
        when: the message must fulfil it; written ``if``.
        direction: only requests, or only responses; None for both.
        probability: share of the messages that it strikes, of those that all else holds for.
        times: after so many strikes it is done.
        after: it begins so long after it was set up.
        lasts: it ends so long after it began; None for never. Written ``for``.
        attempt: only the n-th try of a call, or the response to that try; 1 is the first. Written ``try``.
    """

    name: Annotated[str, Meta(pattern=r"^[\w.+-]{0,60}$")] = ""
    when: FrameCondition | None = None
    direction: Direction | None = None
    probability: Share = ALWAYS
    times: Count | None = None
    after: Duration = Duration(0)
    lasts: Duration | None = None
    attempt: Count | None = None

    needs_whole_frame: ClassVar[bool] = False
    """Whether the action itself must see a whole frame, whatever the conditions say."""

    @property
    def action(self) -> str:
        """The word for what it does, as in files and on the command line."""
        return str(self.__struct_config__.tag)

    @property
    def needs_frames(self) -> bool:
        """Whether a stream must be cut into frames for it."""
        return (
            self.needs_whole_frame
            or self.when is not None
            or self.attempt is not None
            or self.probability < 1
        )


class PassFault(Fault, frozen=True, kw_only=True, tag="pass"):
    """Nothing becomes of the message, whatever the faults after this one would do."""


class DropFault(Fault, frozen=True, kw_only=True, tag="drop"):
    """The message is lost."""

    needs_whole_frame: ClassVar[bool] = True


class BurstFault(Fault, frozen=True, kw_only=True, tag="burst"):
    """Messages are lost in bursts: the model of Gilbert and Elliott, each direction on its own.

    Attributes:
        enter: probability that a good state turns bad, at each message.
        leave: probability that a bad state turns good, at each message.
        bad: share lost in the bad state.
        good: share lost in the good state.
    """

    enter: Share
    leave: Share
    bad: Share = ALWAYS
    good: Share = NEVER

    needs_whole_frame: ClassVar[bool] = True


class DelayFault(Fault, frozen=True, kw_only=True, tag="delay"):
    """The message goes on later. Datagrams may overtake it, bytes of a stream never do.

    Attributes:
        time: how much later.
        jitter: more or less by so much; never less than no delay.
        distribution: of the jitter.
    """

    time: Duration
    jitter: Duration = Duration(0)
    distribution: JitterDistribution = JitterDistribution.UNIFORM


class DuplicateFault(Fault, frozen=True, kw_only=True, tag="duplicate"):
    """The message arrives several times.

    Attributes:
        copies: besides the message itself.
        time: between one and the next.
    """

    copies: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: Duration = Duration(0)

    needs_whole_frame: ClassVar[bool] = True


class ReorderFault(Fault, frozen=True, kw_only=True, tag="reorder"):
    """The message is overtaken by those that come after it, on TCP too: there a server answers out of order.

    Attributes:
        by: how many go before it.
        time: it goes on after this at the latest, though fewer have come.
    """

    by: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: Duration = Duration(100 * MS)

    needs_whole_frame: ClassVar[bool] = True


class CorruptFault(Fault, frozen=True, kw_only=True, tag="corrupt"):
    """Bits are turned over.

    Attributes:
        bits: how many; by lot the same may be hit twice, which leaves it as it was.
        offset: of the byte that is hit; None for any.
    """

    bits: Annotated[int, Meta(ge=1, le=10_000)] = 1
    offset: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class TruncateFault(Fault, frozen=True, kw_only=True, tag="truncate"):
    """The end is cut off.

    Attributes:
        keep: bytes that are left; None for any number, by lot.
    """

    keep: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class GarbageFault(Fault, frozen=True, kw_only=True, tag="garbage"):
    """Random bytes arrive in place of the message; of responses, unless told otherwise.

    Attributes:
        size: bytes; None for as many as the message has.
    """

    direction: Direction | None = Direction.RESPONSE
    size: Annotated[int, Meta(ge=1, le=65507)] | None = None

    needs_whole_frame: ClassVar[bool] = True


class RewriteFault(Fault, frozen=True, kw_only=True, tag="rewrite"):
    """Numbers in the frame are changed. Where nothing changes, the bytes stay those that came.

    Attributes:
        serial: the new one.
        reserved: the new one.
        code: the new function id of a request, or HRESULT of a response.
        set: the new value of arguments or elements: ``{"arg[2][0]": 10}``. It keeps its type, unless the text
            begins with one: ``r4:10``.
        limit: a number beyond the span becomes its end; of an array every element.
        step: a number changes by so much at most from one such message of a conversation to the next.
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
            raise ValueError("a rewrite needs serial, reserved, code, set, limit or step")
        for path in (*self.set, *self.limit, *self.step):
            read_path(path)


class SerialFault(Fault, frozen=True, kw_only=True, tag="serial"):
    """The frame has a wrong serial; of responses, unless told otherwise.

    Attributes:
        by: what is added to the right one.
    """

    direction: Direction | None = Direction.RESPONSE
    by: Annotated[int, Meta(ge=-65535, le=65535)] = 1

    needs_whole_frame: ClassVar[bool] = True


class AnswerFault(Fault, frozen=True, kw_only=True, tag="answer"):
    """The client is answered with a result and no value; its request does not go on.

    With the direction `response` the request goes on, and the result stands in place of what came back.

    Attributes:
        hresult: the result.
    """

    direction: Direction | None = Direction.REQUEST
    hresult: HresultQuantity

    needs_whole_frame: ClassVar[bool] = True


class ExecutingFault(Fault, frozen=True, kw_only=True, tag="executing"):
    """The client hears S_EXECUTING for a while, then the message goes on: a response, unless told otherwise.

    Attributes:
        time: how long.
        every: between two notices; the first comes at once.
    """

    direction: Direction | None = Direction.RESPONSE
    time: Duration
    every: Duration = Duration(100 * MS)

    needs_whole_frame: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.every < MS:
            raise ValueError("every is 1ms at least")
        if self.time > self.every * MAX_NOTICES:
            raise ValueError(f"more than {MAX_NOTICES} notices")


class CloseFault(Fault, frozen=True, kw_only=True, tag="close"):
    """The client's TCP connection ends, on both sides, and the message is lost. UDP is left alone.

    Attributes:
        how: by reset, or in order, after what other faults hold of it.
    """

    how: CloseMode = CloseMode.RESET

    needs_whole_frame: ClassVar[bool] = True


class BandwidthFault(Fault, frozen=True, kw_only=True, tag="bandwidth"):
    """Messages go through a line of that rate, one line for each direction.

    Attributes:
        rate: of the line.
        queue: bytes that wait before datagrams are lost; bytes of a stream wait without bound.
    """

    rate: Rate
    queue: Annotated[int, Meta(ge=1, le=1 << 30)] = 256 * 1024


class PartitionFault(Fault, frozen=True, kw_only=True, tag="partition"):
    """Nothing gets through. Datagrams are lost; bytes of a stream come when it ends, as if sent again."""


class HalfOpenFault(Fault, frozen=True, kw_only=True, tag="half-open"):
    """From now on nothing of this conversation gets through either way, for good, and no end of it either."""


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
"""Every fault; `action` tells them apart in a document."""

ACTIONS: Mapping[str, type[Fault]] = MappingProxyType(
    {str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)}
)
"""The class of each action."""

ALIASES: Mapping[str, str] = MappingProxyType({"loss": "drop"})
"""Other words for actions, as netem has them; where one stands its main value is meant as well."""
