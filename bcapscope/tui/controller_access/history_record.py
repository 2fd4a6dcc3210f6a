"""A call that was made, with all that belongs to it, as the history keeps it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from bcapscope.client.controller_target import os_error_text
from bcapscope.errors import Attempt, BcapError
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.handle_table import ObjectHandle
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.tui.words import say, told


class RecordOutcome(StrEnum):
    """How a call ended."""

    ANSWERED = "answered"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    ABANDONED = "given up"
    """By us, before an answer came: cancelled, or the link is gone."""


class Initiator(StrEnum):
    """Who wanted a call."""

    USER = "user"
    SCREEN = "screen"
    """The program itself: to learn what the peer is, to recover, to let go."""
    WATCH = "watch"


@dataclass(frozen=True, slots=True)
class HistoryRecord:
    """One call.

    Attributes:
        number: from 1, in the order in which they began.
        initiator: wanted it.
        began: when its first try went out, ns since 1970-01-01 UTC.
        function_id: what was called.
        arguments: of the request.
        outcome: how it ended.
        reply: the one that counted; None where there was none.
        took: ns from the first try to the reply, or to the end.
        attempts: all tries.
        packets: everything sent and received for it, in order.
        notices: how often S_EXECUTING came.
        late_replies: replies that did not count.
        subject: what it was made of, such as a variable; None where that was not open.
    """

    number: int
    initiator: Initiator
    began: int
    function_id: int
    arguments: tuple[Variant, ...]
    outcome: RecordOutcome
    reply: Frame | None
    took: int
    attempts: tuple[Attempt, ...]
    packets: tuple[Observation, ...] = field(repr=False)
    notices: int = 0
    late_replies: int = 0
    subject: ObjectHandle | None = None

    @property
    def size(self) -> int:
        """Bytes of the packets."""
        return sum(len(each.item.raw) for each in self.packets)

    @property
    def sent_packets(self) -> tuple[Observation, ...]:
        """What went out."""
        return tuple(each for each in self.packets if each.flow.direction is Direction.REQUEST)

    @property
    def received_packets(self) -> tuple[Observation, ...]:
        """What came in."""
        return tuple(each for each in self.packets if each.flow.direction is Direction.RESPONSE)

    @property
    def retries(self) -> int:
        """Tries after the first."""
        return max(0, len(self.sent_packets) - 1)


def error_text(error: BcapError | OSError) -> str:
    """Tell in one line what broke; the tries of a time-out stand in the record of its call."""
    if isinstance(error, OSError) and not isinstance(error, BcapError):
        return told(os_error_text(error))
    return told(str(error).partition("\n")[0])


def failure_text(record: HistoryRecord) -> str:
    """Tell in a clause how a call ended that did not succeed."""
    if record.outcome is RecordOutcome.REFUSED and record.reply is not None:
        code = record.reply.code
        return f"{hresult_name(code)}, {told(describe_hresult(code).text)}"
    if record.outcome is RecordOutcome.UNANSWERED:
        tries = len(record.attempts)
        return say("desk.unanswered.one" if tries == 1 else "desk.unanswered.many", tries=tries)
    return say("desk.given_up")
