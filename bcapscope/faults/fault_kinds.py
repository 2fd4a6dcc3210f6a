"""The classes of the faults."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args

from msgspec import Meta, field

from bcapscope.errors import InputError
from bcapscope.faults.fault import CloseMode, JitterDistribution, MessageFault
from bcapscope.faults.quantities import (
    LARGEST_END,
    DurationQuantity,
    HresultQuantity,
    Rate,
    Share,
    Span,
    read_path,
)
from bcapscope.faults.reply_factory import encode_reply
from bcapscope.faults.rewriter import Rewriter, with_header
from bcapscope.faults.wire_message import FaultedMessage, WireMessage
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import LARGEST_FRAME
from bcapscope.protocol.tables.hresult import S_EXECUTING, hresult_name
from bcapscope.traffic.observation import Direction

if TYPE_CHECKING:
    from bcapscope.faults.fault_injector import ActiveFault

MS = 1_000_000
MAX_NOTICES = 10_000

UInt16: TypeAlias = Annotated[int, Meta(ge=0, le=0xFFFF)]
RewriteValue: TypeAlias = int | float | bool | str

PARETO_SHAPE = 3.0
"""Shape parameter of the Pareto distribution, with the same value as in tc-netem(8)."""

# DelayFault subtracts this mean from each random number, so that the mean deviation from `time` is 0.
_PARETO_MEAN = PARETO_SHAPE / (PARETO_SHAPE - 1)


class PassFault(MessageFault, frozen=True, kw_only=True, tag="pass"):
    """Forward the message, and skip all faults after this fault in the list."""

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.is_final = True
        return Message("fault.passed")


class DropFault(MessageFault, frozen=True, kw_only=True, tag="drop"):
    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.drop()
        return Message("fault.dropped")


class BurstFault(MessageFault, frozen=True, kw_only=True, tag="burst"):
    """Drop messages in bursts, with the Gilbert-Elliott model, separately for each direction.

    Attributes:
        enter, leave: Probability per message that the bad state begins or ends.
        bad, good: Share of the messages that are dropped in the bad state and in the good state.
    """

    enter: Share
    leave: Share
    bad: Share = Share(1)
    good: Share = Share(0)

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        turn, loss = active.rng.random(), active.rng.random()
        is_bad: bool = active.state.get(message.flow.direction, False)
        if turn < (self.leave if is_bad else self.enter):
            active.state[message.flow.direction] = is_bad = not is_bad
        return loss < (self.bad if is_bad else self.good) or None

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.drop()
        return Message("fault.dropped.burst")


class DelayFault(MessageFault, frozen=True, kw_only=True, tag="delay"):
    """Delay the message by `time` plus a random deviation, which `jitter` scales. The delay is never
    negative. Other datagrams may overtake a delayed datagram; bytes of a stream stay in order.
    """

    time: DurationQuantity
    jitter: DurationQuantity = DurationQuantity(0)
    distribution: JitterDistribution = JitterDistribution.UNIFORM

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        if not self.jitter:
            return self.time
        return max(0, round(self.time + self.jitter * self._draw_deviation(active.rng)))

    def _draw_deviation(self, rng: random.Random) -> float:
        match self.distribution:
            case JitterDistribution.NORMAL:
                return rng.normalvariate(0, 1)
            case JitterDistribution.PARETO:
                return rng.paretovariate(PARETO_SHAPE) - _PARETO_MEAN
        return 2 * rng.random() - 1

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.delay += drawn
        return _delayed(drawn)


class DuplicateFault(MessageFault, frozen=True, kw_only=True, tag="duplicate"):
    """Send `copies` more copies of the message, each `time` after the one before."""

    copies: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: DurationQuantity = DurationQuantity(0)

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.copy_delays += [self.time * number for number in range(1, self.copies + 1)]
        case = "fault.duplicated" if self.copies == 1 else "fault.duplicated.times"
        return Message(case, count=self.copies)


class ReorderFault(MessageFault, frozen=True, kw_only=True, tag="reorder"):
    """Hold the message until `by` later messages have overtaken it, but at most for `time`. On TCP, frames
    are reordered, so the controller seems to reply out of order.
    """

    by: Annotated[int, Meta(ge=1, le=1000)] = 1
    time: DurationQuantity = DurationQuantity(100 * MS)

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.held_behind = (self.by, self.time)
        return Message("fault.reordered", count=self.by)


class CorruptFault(MessageFault, frozen=True, kw_only=True, tag="corrupt"):
    """Flip `bits` random bits of the byte at `offset`, or of the whole message if `offset` is None. A bit
    that is flipped twice has its old value.
    """

    bits: Annotated[int, Meta(ge=1, le=10_000)] = 1
    offset: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        return [active.rng.random() for _ in range(self.bits)]

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        data = bytearray(faulted.data)
        first, count = 0, len(data)
        if self.offset is not None:
            first, count = self.offset, int(self.offset < len(data))
        if not count:
            return None
        hit = set()
        for lot in drawn:
            bit = first * 8 + int(lot * count * 8)
            data[bit // 8] ^= 1 << bit % 8
            hit.add(bit // 8)
        faulted.data = bytes(data)
        some = ", ".join(map(str, sorted(hit)[:4])) + (", …" if len(hit) > 4 else "")
        return Message("fault.corrupted", bytes=some)


class TruncateFault(MessageFault, frozen=True, kw_only=True, tag="truncate"):
    """Cut the message after `keep` bytes, or after a random number of bytes if `keep` is None."""

    keep: Annotated[int, Meta(ge=0, le=LARGEST_FRAME)] | None = None

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        return self.keep is not None or active.rng.random()

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        size = len(faulted.data)
        keep = int(drawn * size) if self.keep is None else self.keep
        if keep >= size:
            return None
        faulted.data = faulted.data[:keep]
        return Message("fault.cut", kept=keep, size=size)


class GarbageFault(MessageFault, frozen=True, kw_only=True, tag="garbage"):
    """Replace the message by `size` random bytes. If `size` is None, the message keeps its length."""

    direction: Direction | None = Direction.RESPONSE
    size: Annotated[int, Meta(ge=1, le=65507)] | None = None

    def draw(self, active: ActiveFault, message: WireMessage) -> Any:
        return active.rng.getrandbits(64)

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        size = self.size or len(faulted.data)
        faulted.data = random.Random(drawn).randbytes(size)
        return Message("fault.garbage", size=size)


class RewriteFault(MessageFault, frozen=True, kw_only=True, tag="rewrite"):
    """Change numbers in the frame. If nothing changes, the received bytes are forwarded.

    Attributes:
        code: New function id of a request, or new HRESULT of a response.
        set: New values of arguments or elements: ``{"arg[2][0]": 10}``. A value keeps its type unless the
            text names another type, as in ``r4:10``.
        limit: Permitted ranges of arguments or elements. A number outside its range becomes the nearest end
            of the range. If an argument is an array, its range applies to every element.
        step: Largest change of a number from one message to the next similar message; see `Rewriter`.
    """

    serial: UInt16 | None = None
    reserved: UInt16 | None = None
    code: HresultQuantity | None = None
    set: dict[str, RewriteValue] = field(default_factory=dict)
    limit: dict[str, Span] = field(default_factory=dict)
    step: dict[str, Annotated[float, Meta(gt=0, le=LARGEST_END)]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.serial is self.reserved is self.code is None and not (self.set or self.limit or self.step):
            raise InputError(Message("fault.rewrite-nothing"))
        for path in (*self.set, *self.limit, *self.step):
            read_path(path)

    def initial_state(self) -> Any:
        return Rewriter(self)

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        raw = b"".join(active.state.rewrite(frame, faulted.original.flow) for frame in faulted.frames)
        if raw in (b"", faulted.data):
            return None
        faulted.data = raw
        return Message("fault.rewritten")


class SerialFault(MessageFault, frozen=True, kw_only=True, tag="serial"):
    direction: Direction | None = Direction.RESPONSE
    by: Annotated[int, Meta(ge=-65535, le=65535)] = 1

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        frames = faulted.frames
        if not frames:
            return None
        faulted.data = b"".join(
            with_header(frame, serial=(frame.serial + self.by) & 0xFFFF) for frame in frames
        )
        return Message("fault.serial", by=f"{self.by:+d}")


class AnswerFault(MessageFault, frozen=True, kw_only=True, tag="answer"):
    """Answer a request with the result code `hresult` and without a value. Do not forward the request. If
    `direction` is `response`, replace the controller's reply with this answer.
    """

    direction: Direction | None = Direction.REQUEST
    hresult: HresultQuantity

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        frames, flow, code = faulted.frames, faulted.original.flow, self.hresult
        if not frames:
            return None
        if flow.direction is Direction.RESPONSE:
            faulted.data = b"".join(encode_reply(frame, frame.reserved, code) for frame in frames)
            return Message("fault.answer-replaced", code=hresult_name(code))
        answers = [faulted.reply_factory.make_reply(flow.conversation, frame, code) for frame in frames]
        faulted.replies += [(faulted.delay, raw) for raw in answers]
        faulted.drop()
        return Message("fault.answered", code=hresult_name(code))


class ExecutingFault(MessageFault, frozen=True, kw_only=True, tag="executing"):
    """Send notices to the client for `time`, the first one at once, then forward the message."""

    direction: Direction | None = Direction.RESPONSE
    time: DurationQuantity
    every: DurationQuantity = DurationQuantity(100 * MS)

    def __post_init__(self) -> None:
        if self.every < MS:
            raise InputError(Message("fault.notices-often"))
        if self.time > self.every * MAX_NOTICES:
            raise InputError(Message("fault.notices-many", limit=MAX_NOTICES))

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        frames, flow = faulted.frames, faulted.original.flow
        if not frames:
            return None
        for frame in frames:
            if flow.direction is Direction.REQUEST:
                raw = faulted.reply_factory.make_reply(flow.conversation, frame, S_EXECUTING)
            else:
                raw = encode_reply(frame, frame.reserved, S_EXECUTING)
            faulted.replies += [(faulted.delay + late, raw) for late in range(0, self.time, self.every)]
        faulted.delay += self.time
        return Message("fault.executing", time=_milliseconds(self.time))


class CloseFault(MessageFault, frozen=True, kw_only=True, tag="close"):
    """Close the TCP connections to client and controller, and drop the message. UDP is not affected. An RST
    closes the connections at once. A FIN closes the connections after all held messages of the conversation
    are sent.
    """

    how: CloseMode = CloseMode.RESET

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        if faulted.original.is_datagram:
            return None
        faulted.close_mode = self.how
        faulted.drop()
        return Message(f"fault.connection-{self.how}")


class BandwidthFault(MessageFault, frozen=True, kw_only=True, tag="bandwidth"):
    """Limit the bandwidth, separately for each direction. Messages beyond the bandwidth wait. If more than
    `queue` bytes would wait, drop the datagram. TCP streams have no such limit: this fault drops none of
    their bytes.
    """

    rate: Rate
    queue: Annotated[int, Meta(ge=1, le=1 << 30)] = 256 * 1024

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        message = faulted.original
        direction = message.flow.direction
        arrives = message.now + faulted.delay
        starts: int = max(arrives, active.state.get(direction, arrives))
        waiting = (starts - arrives) / 1e9 * self.rate
        if message.is_datagram and waiting + len(faulted.data) > self.queue:
            faulted.drop()
            return Message("fault.dropped.queue")
        done = starts + round(len(faulted.data) / self.rate * 1e9)
        active.state[direction] = done
        faulted.delay = done - message.now
        return _delayed(done - arrives)


class PartitionFault(MessageFault, frozen=True, kw_only=True, tag="partition"):
    """Drop datagrams, and hold the bytes of TCP streams until the partition ends, as if TCP had sent them
    again. A partition without the field `lasts` never ends. This partition drops the bytes of streams,
    because it could never release them.
    """

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        if faulted.original.is_datagram or active.ends_at is None:
            faulted.drop()
            return Message("fault.dropped")
        faulted.delay = max(faulted.delay, active.ends_at - faulted.original.now)
        return Message("fault.held")


class HalfOpenFault(MessageFault, frozen=True, kw_only=True, tag="half-open"):
    """Block the conversation permanently, in both directions. Neither end notices if the other end closes the
    connection.
    """

    def apply(self, faulted: FaultedMessage, drawn: Any, active: ActiveFault) -> Message | None:
        faulted.half_open = True
        faulted.drop()
        return Message("fault.dropped.dead")


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

ACTIONS: dict[str, type[MessageFault]] = {
    str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)
}

ALIASES = {"loss": "drop"}
"""Other names of actions, from tc-netem(8). The notation for ``loss`` requires a value: ``loss=5%``."""


def _delayed(duration: int) -> Message:
    return Message("fault.delayed", time=_milliseconds(duration))


def _milliseconds(duration: int) -> str:
    return f"{duration / 1e6:.3f}".rstrip("0").rstrip(".") + " ms"
