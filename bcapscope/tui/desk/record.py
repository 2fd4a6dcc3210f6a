"""A call that was made, with all that belongs to it, as the history keeps it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from bcapscope.client.target import reason_of
from bcapscope.errors import Attempt, BcapError
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.opened import Opened
from bcapscope.tui.words import say, told


class Ending(StrEnum):
    """How a call ended."""

    ANSWERED = "answered"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    GIVEN_UP = "given up"
    """By us, before an answer came: cancelled, or the link is gone."""


class Who(StrEnum):
    """Who wanted a call."""

    USER = "user"
    SCREEN = "screen"
    """The program itself: to learn what the peer is, to recover, to let go."""
    WATCH = "watch"


@dataclass(frozen=True, slots=True)
class Record:
    """One call.

    Attributes:
        number: from 1, in the order in which they began.
        who: wanted it.
        began: when its first try went out, ns since 1970-01-01 UTC.
        function_id: what was called.
        arguments: of the request.
        ending: how it ended.
        reply: the one that counted; None where there was none.
        took: ns from the first try to the reply, or to the end.
        attempts: all tries.
        packets: everything sent and received for it, in order.
        notices: how often S_EXECUTING came.
        late: replies that did not count.
        subject: what it was made of, such as a variable; None where that was not open.
    """

    number: int
    who: Who
    began: int
    function_id: int
    arguments: tuple[Variant, ...]
    ending: Ending
    reply: Frame | None
    took: int
    attempts: tuple[Attempt, ...]
    packets: tuple[Observation, ...] = field(repr=False)
    notices: int = 0
    late: int = 0
    subject: Opened | None = None

    @property
    def size(self) -> int:
        """Bytes of the packets."""
        return sum(len(each.item.raw) for each in self.packets)

    @property
    def sent(self) -> tuple[Observation, ...]:
        """What went out."""
        return tuple(each for each in self.packets if each.flow.direction is Direction.REQUEST)

    @property
    def received(self) -> tuple[Observation, ...]:
        """What came in."""
        return tuple(each for each in self.packets if each.flow.direction is Direction.RESPONSE)

    @property
    def retries(self) -> int:
        """Tries after the first."""
        return max(0, len(self.sent) - 1)


def cause(error: BcapError | OSError) -> str:
    """Tell in one line what broke; the tries of a time-out stand in the record of its call."""
    if isinstance(error, OSError) and not isinstance(error, BcapError):
        return told(reason_of(error))
    return told(str(error).partition("\n")[0])


def why(record: Record) -> str:
    """Tell in a clause how a call ended that did not succeed."""
    if record.ending is Ending.REFUSED and record.reply is not None:
        code = record.reply.code
        return f"{hresult_name(code)}, {told(describe(code).text)}"
    if record.ending is Ending.UNANSWERED:
        tries = len(record.attempts)
        return say("desk.unanswered.one" if tries == 1 else "desk.unanswered.many", tries=tries)
    return say("desk.given_up")
