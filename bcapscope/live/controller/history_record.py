"""A call in the Tester's history, with its packets and outcome."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.errors import Attempt, BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.observation import Direction, Observation

Reason: TypeAlias = tuple[Message | str, ...]
"""Result of a step, or the reason for its failure. The screen joins the items of the tuple with commas."""


class RecordOutcome(StrEnum):
    ANSWERED = "answered"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    ABANDONED = "given up"
    """The client cancelled the call before a reply arrived, or the link was lost."""


class Initiator(StrEnum):
    USER = "user"
    SCREEN = "screen"
    """bcapscope made the call on its own: to identify the controller, to recover, or to release objects."""
    WATCH = "watch"


@dataclass(frozen=True, slots=True)
class HistoryRecord:
    """One call in the Tester's history.

    Attributes:
        number: Number of the call, counted from 1 in the order in which the calls started.
        began: Time of the first attempt, ns since 1970-01-01 UTC.
        took: Time in ns from the first attempt to the reply or to the end of the call.
        packets: Packets sent and received for the call, in order; at most `history_recorder.MAX_PACKETS`.
        notices: Number of S_EXECUTING notices.
        subject: Object whose handle the call used, such as a variable; None if no such object was open.
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
        return sum(len(each.item.raw) for each in self.packets)

    @property
    def sent_packets(self) -> tuple[Observation, ...]:
        return tuple(each for each in self.packets if each.flow.direction is Direction.REQUEST)

    @property
    def received_packets(self) -> tuple[Observation, ...]:
        return tuple(each for each in self.packets if each.flow.direction is Direction.RESPONSE)

    @property
    def retries(self) -> int:
        return max(0, len(self.sent_packets) - 1)


def error_reason(error: BcapError | OSError) -> Reason:
    return (error.message if isinstance(error, BcapError) else os_reason(error),)


def failure_reason(record: HistoryRecord) -> Reason:
    if record.outcome is RecordOutcome.REFUSED and record.reply is not None:
        code = record.reply.code
        return hresult_name(code), describe_hresult(code).meaning
    if record.outcome is RecordOutcome.UNANSWERED:
        return (Message("controller.no-reply", attempts=Count(len(record.attempts), "attempt")),)
    return (Message("controller.cancelled"),)
