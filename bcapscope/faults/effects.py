"""What each fault does to a message that it strikes.

An effect has two parts. `draw` takes what is left to chance from the fault's own random numbers, for every
message that the fault might strike, so that what other faults do to the same messages changes nothing in it.
`apply` does it.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from bcapscope.faults.answers import Manners, reply_to
from bcapscope.faults.fault import (
    Answer,
    Bandwidth,
    Burst,
    Close,
    Corrupt,
    Delay,
    Distribution,
    Drop,
    Duplicate,
    Ending,
    Executing,
    Fault,
    Garbage,
    HalfOpen,
    Partition,
    Pass,
    Reorder,
    Rewrite,
    Serial,
    Truncate,
)
from bcapscope.faults.message import Message
from bcapscope.faults.rewriting import Rewriter, with_header
from bcapscope.protocol.frame import Frame, parse_datagram
from bcapscope.protocol.hresult import S_EXECUTING, hresult_name
from bcapscope.traffic.observation import Conversation, Direction

F = TypeVar("F", bound=Fault)

PARETO_SHAPE = 3.0
"""As tc-netem's pareto table has it; the mean of the draws is taken off, so that the delay stays the mean."""

_PARETO_MEAN = PARETO_SHAPE / (PARETO_SHAPE - 1)


class Work:
    """A message while faults are at it.

    Attributes:
        message: as it came.
        data: the bytes as they are now.
        delay: ns that it is late by now.
        gone: it does not go on.
        done: no further fault gets at it.
        copies: ns behind it, for each copy.
        overtaken: how many messages go before it, and ns that it waits for them.
        back: what the client is told by us: ns from now, and the bytes.
        ending: of the connection.
        half_open: the conversation is dead from now on.
    """

    __slots__ = (
        "back",
        "copies",
        "data",
        "delay",
        "done",
        "ending",
        "gone",
        "half_open",
        "manners",
        "message",
        "overtaken",
    )

    def __init__(self, message: Message, manners: Manners) -> None:
        self.message = message
        self.manners = manners
        self.data = message.data
        self.delay = 0
        self.gone = False
        self.done = False
        self.copies: list[int] = []
        self.overtaken: tuple[int, int] | None = None
        self.back: list[tuple[int, bytes]] = []
        self.ending: Ending | None = None
        self.half_open = False

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames as they are now; there are none if anything else is among the bytes."""
        if self.data is self.message.data:
            return self.message.frames
        items = parse_datagram(self.data)
        frames = tuple(item for item in items if isinstance(item, Frame))
        return frames if len(frames) == len(items) else ()

    def lose(self) -> None:
        """Let the message end here."""
        self.gone = self.done = True


class Effect(Generic[F]):
    """What a fault does. This one does nothing."""

    def __init__(self, fault: F) -> None:
        self.fault = fault

    def draw(self, lots: random.Random, message: Message) -> Any:
        """Take what is left to chance; None if the message gets off."""
        return True

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        """Do it.

        Args:
            work: to do it to.
            drawn: what `draw` gave.
            ends: when the fault ends, ns; None for never.

        Returns:
            What was done, for people; "" if nothing was.
        """
        work.done = True
        return "passed"

    def forget(self, conversation: Conversation) -> None:
        """Forget a conversation that is over."""


class _Drop(Effect[Drop]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        work.lose()
        return "dropped"


class _Burst(Effect[Burst]):
    def __init__(self, fault: Burst) -> None:
        super().__init__(fault)
        self._bad = {direction: False for direction in Direction}

    def draw(self, lots: random.Random, message: Message) -> Any:
        direction, fault = message.flow.direction, self.fault
        turn, loss = lots.random(), lots.random()
        if turn < (fault.leave if self._bad[direction] else fault.enter):
            self._bad[direction] = not self._bad[direction]
        return loss < (fault.bad if self._bad[direction] else fault.good) or None

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        work.lose()
        return "dropped in a burst"


class _Delay(Effect[Delay]):
    def draw(self, lots: random.Random, message: Message) -> Any:
        return max(0, round(self.fault.time + self.fault.jitter * self._deviation(lots)))

    def _deviation(self, lots: random.Random) -> float:
        if not self.fault.jitter:
            return 0
        match self.fault.distribution:
            case Distribution.NORMAL:
                return lots.normalvariate(0, 1)
            case Distribution.PARETO:
                return lots.paretovariate(PARETO_SHAPE) - _PARETO_MEAN
        return 2 * lots.random() - 1

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        work.delay += drawn
        return f"delayed by {milliseconds(drawn)}"


class _Duplicate(Effect[Duplicate]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        fault = self.fault
        work.copies += [fault.time * number for number in range(1, fault.copies + 1)]
        return "duplicated" if fault.copies == 1 else f"duplicated {fault.copies} times"


class _Reorder(Effect[Reorder]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        work.overtaken = (self.fault.by, self.fault.time)
        return f"held back behind {self.fault.by} more"


class _Corrupt(Effect[Corrupt]):
    def draw(self, lots: random.Random, message: Message) -> Any:
        return [lots.random() for _ in range(self.fault.bits)]

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        data = bytearray(work.data)
        first, count = 0, len(data)
        if self.fault.offset is not None:
            first, count = self.fault.offset, min(1, max(0, len(data) - self.fault.offset))
        if not count:
            return ""
        hit = set()
        for lot in drawn:
            bit = first * 8 + int(lot * count * 8)
            data[bit // 8] ^= 1 << bit % 8
            hit.add(bit // 8)
        work.data = bytes(data)
        places = sorted(hit)
        some = f"{', '.join(map(str, places[:4]))}{', …' if len(places) > 4 else ''}"
        return f"corrupted at byte {some}"


class _Truncate(Effect[Truncate]):
    def draw(self, lots: random.Random, message: Message) -> Any:
        return lots.random() if self.fault.keep is None else 0.0

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        size = len(work.data)
        keep = int(drawn * size) if self.fault.keep is None else self.fault.keep
        if keep >= size:
            return ""
        work.data = work.data[:keep]
        return f"cut to {keep} of {size} bytes"


class _Garbage(Effect[Garbage]):
    def draw(self, lots: random.Random, message: Message) -> Any:
        return (lots.getrandbits(64),)

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        size = self.fault.size or len(work.data)
        work.data = random.Random(drawn[0]).randbytes(size)
        return f"replaced by {size} random bytes"


class _Rewrite(Effect[Rewrite]):
    def __init__(self, fault: Rewrite) -> None:
        super().__init__(fault)
        self._rewriter = Rewriter(fault)

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        changed = [self._rewriter.apply(frame, work.message.flow) for frame in work.frames]
        raw = b"".join(changed)
        if not changed or raw == work.data:
            return ""
        work.data = raw
        return "rewritten"

    def forget(self, conversation: Conversation) -> None:
        self._rewriter.forget(conversation)


class _Serial(Effect[Serial]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        frames = work.frames
        if not frames:
            return ""
        work.data = b"".join(
            with_header(frame, serial=(frame.serial + self.fault.by) & 0xFFFF) for frame in frames
        )
        return f"serial changed by {self.fault.by:+d}"


class _Answer(Effect[Answer]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        frames, flow, code = work.frames, work.message.flow, self.fault.hresult
        if not frames:
            return ""
        if flow.direction is Direction.RESPONSE:
            work.data = b"".join(reply_to(frame, frame.reserved, code) for frame in frames)
            return f"answer replaced by {hresult_name(code)}"
        answers = [work.manners.answer(flow.conversation, frame, code) for frame in frames]
        work.back += [(work.delay, raw) for raw in answers]
        work.lose()
        return f"answered with {hresult_name(code)}"


class _Executing(Effect[Executing]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        frames, flow, fault = work.frames, work.message.flow, self.fault
        if not frames:
            return ""
        for frame in frames:
            if flow.direction is Direction.REQUEST:
                raw = work.manners.answer(flow.conversation, frame, S_EXECUTING)
            else:
                raw = reply_to(frame, frame.reserved, S_EXECUTING)
            work.back += [(work.delay + late, raw) for late in range(0, fault.time, fault.every)]
        work.delay += fault.time
        return f"S_EXECUTING for {milliseconds(fault.time)}"


class _Close(Effect[Close]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        if work.message.datagram:
            return ""
        work.ending = self.fault.how
        work.lose()
        return "connection reset" if self.fault.how is Ending.RESET else "connection closed"


class _Bandwidth(Effect[Bandwidth]):
    def __init__(self, fault: Bandwidth) -> None:
        super().__init__(fault)
        self._free_at = dict.fromkeys(Direction, 0)

    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        message, fault = work.message, self.fault
        direction = message.flow.direction
        arrives = message.now + work.delay
        starts = max(arrives, self._free_at[direction])
        waiting = (starts - arrives) / 1e9 * fault.rate
        if message.datagram and waiting + len(work.data) > fault.queue:
            work.lose()
            return "dropped, the line's queue is full"
        done = starts + round(len(work.data) / fault.rate * 1e9)
        self._free_at[direction] = done
        work.delay = done - message.now
        return f"delayed by {milliseconds(done - arrives)}"


class _Partition(Effect[Partition]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        if work.message.datagram or ends is None:
            work.lose()
            return "dropped"
        work.delay = max(work.delay, ends - work.message.now)
        return "held until the partition ends"


class _HalfOpen(Effect[HalfOpen]):
    def apply(self, work: Work, drawn: Any, ends: int | None) -> str:
        work.half_open = True
        work.lose()
        return "dropped, the conversation is dead"


EFFECTS: Mapping[type[Fault], type[Effect[Any]]] = {
    Pass: Effect,
    Drop: _Drop,
    Burst: _Burst,
    Delay: _Delay,
    Duplicate: _Duplicate,
    Reorder: _Reorder,
    Corrupt: _Corrupt,
    Truncate: _Truncate,
    Garbage: _Garbage,
    Rewrite: _Rewrite,
    Serial: _Serial,
    Answer: _Answer,
    Executing: _Executing,
    Close: _Close,
    Bandwidth: _Bandwidth,
    Partition: _Partition,
    HalfOpen: _HalfOpen,
}
"""What each fault does."""


def milliseconds(duration: int) -> str:
    """Write a duration of ns for people."""
    return f"{duration / 1e6:.3f}".rstrip("0").rstrip(".") + " ms"
