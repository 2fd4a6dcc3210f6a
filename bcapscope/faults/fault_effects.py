"""The effects of the faults on the messages that they hit.

An effect has two parts. `draw` takes random numbers from the fault's own stream, for every message that the
fault might hit. Therefore other faults that act on the same messages do not change the numbers. `apply`
changes the message.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from bcapscope.faults.fault import (
    AnswerFault,
    BandwidthFault,
    BurstFault,
    CloseFault,
    CloseMode,
    CorruptFault,
    DelayFault,
    DropFault,
    DuplicateFault,
    ExecutingFault,
    Fault,
    GarbageFault,
    HalfOpenFault,
    JitterDistribution,
    PartitionFault,
    PassFault,
    ReorderFault,
    RewriteFault,
    SerialFault,
    TruncateFault,
)
from bcapscope.faults.reply_factory import ReplyFactory, encode_reply
from bcapscope.faults.rewriter import Rewriter, with_header
from bcapscope.faults.wire_message import WireMessage
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.protocol.tables.hresult import S_EXECUTING, hresult_name
from bcapscope.traffic.observation import Conversation, Direction

F = TypeVar("F", bound=Fault)

PARETO_SHAPE = 3.0
"""Shape of the Pareto distribution, as in the pareto table of tc-netem(8).

The mean of the draws is subtracted, so that the mean delay stays as set.
"""

_PARETO_MEAN = PARETO_SHAPE / (PARETO_SHAPE - 1)


class FaultedMessage:
    """A message and what faults have done to it so far.

    Attributes:
        original: Message as received.
        data: Current bytes of the message.
        delay: Sum of all delays, in ns.
        is_lost: True if the message is not forwarded.
        is_final: True if later faults are skipped.
        copy_delays: Time of each copy after the message itself, in ns.
        held_behind: Number of messages that overtake this one, and the maximum wait for them in ns; None for
            none.
        replies: Replies for the client that faults have made: delay from now in ns, and the bytes.
        close_mode: How to close the connection; None to keep it open.
        half_open: True if the conversation is blocked from now on.
    """

    __slots__ = (
        "close_mode",
        "copy_delays",
        "data",
        "delay",
        "half_open",
        "held_behind",
        "is_final",
        "is_lost",
        "original",
        "replies",
        "reply_factory",
    )

    def __init__(self, original: WireMessage, reply_factory: ReplyFactory) -> None:
        self.original = original
        self.reply_factory = reply_factory
        self.data = original.data
        self.delay = 0
        self.is_lost = False
        self.is_final = False
        self.copy_delays: list[int] = []
        self.held_behind: tuple[int, int] | None = None
        self.replies: list[tuple[int, bytes]] = []
        self.close_mode: CloseMode | None = None
        self.half_open = False

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Frames in the current bytes; empty if the bytes contain anything else."""
        if self.data is self.original.data:
            return self.original.frames
        items = parse_datagram(self.data)
        frames = tuple(item for item in items if isinstance(item, Frame))
        return frames if len(frames) == len(items) else ()

    def drop(self) -> None:
        """Drop the message and skip later faults."""
        self.is_lost = self.is_final = True


class FaultEffect(Generic[F]):
    """Effect of a fault on a message. This base class forwards the message unchanged."""

    def __init__(self, fault: F) -> None:
        self.fault = fault

    def draw(self, rng: random.Random, message: WireMessage) -> Any:
        """Return the random numbers that `apply` needs; None if the fault does not hit the message."""
        return True

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        """Change the message, with the result of `draw`. Return what was done; None if nothing changed.

        `ends_at` is the time in ns at which the fault ends, or None if it never ends.
        """
        faulted.is_final = True
        return Message("fault.passed")

    def close_conversation(self, conversation: Conversation) -> None:
        """Forget a conversation that has ended."""


class _DropEffect(FaultEffect[DropFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        faulted.drop()
        return Message("fault.dropped")


class _BurstEffect(FaultEffect[BurstFault]):
    def __init__(self, fault: BurstFault) -> None:
        super().__init__(fault)
        self._bad = {direction: False for direction in Direction}

    def draw(self, rng: random.Random, message: WireMessage) -> Any:
        direction, fault = message.flow.direction, self.fault
        turn, loss = rng.random(), rng.random()
        if turn < (fault.leave if self._bad[direction] else fault.enter):
            self._bad[direction] = not self._bad[direction]
        return loss < (fault.bad if self._bad[direction] else fault.good) or None

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        faulted.drop()
        return Message("fault.dropped.burst")


class _DelayEffect(FaultEffect[DelayFault]):
    def draw(self, rng: random.Random, message: WireMessage) -> Any:
        return max(0, round(self.fault.time + self.fault.jitter * self._draw_deviation(rng)))

    def _draw_deviation(self, rng: random.Random) -> float:
        if not self.fault.jitter:
            return 0
        match self.fault.distribution:
            case JitterDistribution.NORMAL:
                return rng.normalvariate(0, 1)
            case JitterDistribution.PARETO:
                return rng.paretovariate(PARETO_SHAPE) - _PARETO_MEAN
        return 2 * rng.random() - 1

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        faulted.delay += drawn
        return _delayed(drawn)


class _DuplicateEffect(FaultEffect[DuplicateFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        fault = self.fault
        faulted.copy_delays += [fault.time * number for number in range(1, fault.copies + 1)]
        return Message(
            "fault.duplicated" if fault.copies == 1 else "fault.duplicated.times", count=fault.copies
        )


class _ReorderEffect(FaultEffect[ReorderFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        faulted.held_behind = (self.fault.by, self.fault.time)
        return Message("fault.reordered", count=self.fault.by)


class _CorruptEffect(FaultEffect[CorruptFault]):
    def draw(self, rng: random.Random, message: WireMessage) -> Any:
        return [rng.random() for _ in range(self.fault.bits)]

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        data = bytearray(faulted.data)
        first, count = 0, len(data)
        if self.fault.offset is not None:
            first, count = self.fault.offset, min(1, max(0, len(data) - self.fault.offset))
        if not count:
            return None
        hit = set()
        for lot in drawn:
            bit = first * 8 + int(lot * count * 8)
            data[bit // 8] ^= 1 << bit % 8
            hit.add(bit // 8)
        faulted.data = bytes(data)
        places = sorted(hit)
        some = f"{', '.join(map(str, places[:4]))}{', …' if len(places) > 4 else ''}"
        return Message("fault.corrupted", bytes=some)


class _TruncateEffect(FaultEffect[TruncateFault]):
    def draw(self, rng: random.Random, message: WireMessage) -> Any:
        return rng.random() if self.fault.keep is None else 0.0

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        size = len(faulted.data)
        keep = int(drawn * size) if self.fault.keep is None else self.fault.keep
        if keep >= size:
            return None
        faulted.data = faulted.data[:keep]
        return Message("fault.cut", kept=keep, size=size)


class _GarbageEffect(FaultEffect[GarbageFault]):
    def draw(self, rng: random.Random, message: WireMessage) -> Any:
        return (rng.getrandbits(64),)

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        size = self.fault.size or len(faulted.data)
        faulted.data = random.Random(drawn[0]).randbytes(size)
        return Message("fault.garbage", size=size)


class _RewriteEffect(FaultEffect[RewriteFault]):
    def __init__(self, fault: RewriteFault) -> None:
        super().__init__(fault)
        self._rewriter = Rewriter(fault)

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        changed = [self._rewriter.rewrite(frame, faulted.original.flow) for frame in faulted.frames]
        raw = b"".join(changed)
        if not changed or raw == faulted.data:
            return None
        faulted.data = raw
        return Message("fault.rewritten")

    def close_conversation(self, conversation: Conversation) -> None:
        self._rewriter.close_conversation(conversation)


class _SerialEffect(FaultEffect[SerialFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        frames = faulted.frames
        if not frames:
            return None
        faulted.data = b"".join(
            with_header(frame, serial=(frame.serial + self.fault.by) & 0xFFFF) for frame in frames
        )
        return Message("fault.serial", by=f"{self.fault.by:+d}")


class _AnswerEffect(FaultEffect[AnswerFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        frames, flow, code = faulted.frames, faulted.original.flow, self.fault.hresult
        if not frames:
            return None
        if flow.direction is Direction.RESPONSE:
            faulted.data = b"".join(encode_reply(frame, frame.reserved, code) for frame in frames)
            return Message("fault.answer-replaced", code=hresult_name(code))
        answers = [faulted.reply_factory.make_reply(flow.conversation, frame, code) for frame in frames]
        faulted.replies += [(faulted.delay, raw) for raw in answers]
        faulted.drop()
        return Message("fault.answered", code=hresult_name(code))


class _ExecutingEffect(FaultEffect[ExecutingFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        frames, flow, fault = faulted.frames, faulted.original.flow, self.fault
        if not frames:
            return None
        for frame in frames:
            if flow.direction is Direction.REQUEST:
                raw = faulted.reply_factory.make_reply(flow.conversation, frame, S_EXECUTING)
            else:
                raw = encode_reply(frame, frame.reserved, S_EXECUTING)
            faulted.replies += [(faulted.delay + late, raw) for late in range(0, fault.time, fault.every)]
        faulted.delay += fault.time
        return Message("fault.executing", time=_milliseconds(fault.time))


class _CloseEffect(FaultEffect[CloseFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        if faulted.original.is_datagram:
            return None
        faulted.close_mode = self.fault.how
        faulted.drop()
        return Message(f"fault.connection-{self.fault.how}")


class _BandwidthEffect(FaultEffect[BandwidthFault]):
    def __init__(self, fault: BandwidthFault) -> None:
        super().__init__(fault)
        self._free_at = dict.fromkeys(Direction, 0)

    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        message, fault = faulted.original, self.fault
        direction = message.flow.direction
        arrives = message.now + faulted.delay
        starts = max(arrives, self._free_at[direction])
        waiting = (starts - arrives) / 1e9 * fault.rate
        if message.is_datagram and waiting + len(faulted.data) > fault.queue:
            faulted.drop()
            return Message("fault.dropped.queue")
        done = starts + round(len(faulted.data) / fault.rate * 1e9)
        self._free_at[direction] = done
        faulted.delay = done - message.now
        return _delayed(done - arrives)


class _PartitionEffect(FaultEffect[PartitionFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        if faulted.original.is_datagram or ends_at is None:
            faulted.drop()
            return Message("fault.dropped")
        faulted.delay = max(faulted.delay, ends_at - faulted.original.now)
        return Message("fault.held")


class _HalfOpenEffect(FaultEffect[HalfOpenFault]):
    def apply(self, faulted: FaultedMessage, drawn: Any, ends_at: int | None) -> Message | None:
        faulted.half_open = True
        faulted.drop()
        return Message("fault.dropped.dead")


EFFECTS: Mapping[type[Fault], type[FaultEffect[Any]]] = {
    PassFault: FaultEffect,
    DropFault: _DropEffect,
    BurstFault: _BurstEffect,
    DelayFault: _DelayEffect,
    DuplicateFault: _DuplicateEffect,
    ReorderFault: _ReorderEffect,
    CorruptFault: _CorruptEffect,
    TruncateFault: _TruncateEffect,
    GarbageFault: _GarbageEffect,
    RewriteFault: _RewriteEffect,
    SerialFault: _SerialEffect,
    AnswerFault: _AnswerEffect,
    ExecutingFault: _ExecutingEffect,
    CloseFault: _CloseEffect,
    BandwidthFault: _BandwidthEffect,
    PartitionFault: _PartitionEffect,
    HalfOpenFault: _HalfOpenEffect,
}


def _delayed(duration: int) -> Message:
    return Message("fault.delayed", time=_milliseconds(duration))


def _milliseconds(duration: int) -> str:
    return f"{duration / 1e6:.3f}".rstrip("0").rstrip(".") + " ms"
