"""A call: a request, its retries, what came back, and what is to be thought of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol, TypeAlias

from bcapscope.protocol.codec.frame import Frame
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import CallVerdict, Outcome, outcome_of, verdict_of
from bcapscope.traffic.observation import Conversation, Flow, Transport
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedConvention, ReservedFieldUsage


class FrameObservation(Protocol):
    """An `Observation` whose item is a frame."""

    @property
    def number(self) -> int: ...
    @property
    def time(self) -> int: ...
    @property
    def first_byte_time(self) -> int: ...
    @property
    def flow(self) -> Flow: ...
    @property
    def item(self) -> Frame: ...
    @property
    def packet(self) -> int: ...


class FrameRole(StrEnum):
    """What a frame is to its call."""

    REQUEST = "request"
    """The first try."""
    RETRY = "retry"
    NOTICE = "executing"
    """S_EXECUTING: still at work."""
    REPLY = "reply"
    """The one that the client accepted."""
    LATE = "late reply"
    """Came after the client had sent another try or had gone on; also one that contradicts an earlier one."""
    LOST = "lost reply"
    """Came before the client sent another try, which it would not have done had it taken this one."""
    DUPLICATE = "duplicate"
    """An exact copy of an earlier request or reply of the same call. All known clients give a retry a new
    serial, so a copy was made by the network or by the capture."""


class CallFrame(NamedTuple):
    """A frame of a call and what it is to it."""

    role: FrameRole
    observation: FrameObservation


class Call:
    """A call as far as it was seen; complete once the tracker has given it out.

    Attributes:
        number: 1 for the call that started first in the traffic, and so on.
        conversation: between whom.
        kind: what was asked.
        request: the first try, or the first that was seen.
        reply: the one that the client accepted; None where it had none, as far as was seen.
        last_attempt: the try that the client sent last; a reply is accepted only if it answers this one.
        other_frames: everything else that belongs to the call, in the order in which it was seen.
        abandoned_at: when the client went on to another call without having had a reply; 0 where it did not.
        last_activity: when anything of the call was last seen.
        no_reply_expected: no reply is to be expected any more, though the client was not seen to go on.
        evicted: given out without a reply while one might still come, since more was open than is kept in
            mind.
        skipped_handles: how many handles the one that came back is ahead of the next in sequence, where so
            many tries went unanswered; otherwise 0.
        reserved_usage: how the conversation used the reserved field, as far as was known when the call
            settled.
        memory_bytes: bytes of its frames, and what keeping them costs, as far as its lane has counted them.
    """

    __slots__ = (
        "abandoned_at",
        "conversation",
        "evicted",
        "kind",
        "last_activity",
        "last_attempt",
        "memory_bytes",
        "no_reply_expected",
        "number",
        "other_frames",
        "reply",
        "request",
        "reserved_usage",
        "skipped_handles",
    )

    def __init__(
        self,
        number: int,
        conversation: Conversation,
        kind: CallKind,
        request: FrameObservation,
        reserved_usage: ReservedFieldUsage,
    ) -> None:
        self.number = number
        self.conversation = conversation
        self.kind = kind
        self.request = self.last_attempt = request
        self.last_activity = request.time
        self.reserved_usage = reserved_usage
        self.reply: FrameObservation | None = None
        self.other_frames: list[CallFrame] | tuple[()] = ()  # nearly all calls share the empty one
        self.abandoned_at = 0
        self.no_reply_expected = self.evicted = False
        self.skipped_handles = self.memory_bytes = 0

    def __repr__(self) -> str:
        events = ", ".join(f"{event.role} {event.observation.number}" for event in self.frames)
        return f"Exchange({self.number}, {self.kind.function_id}, {self.kind.command!r}: {events})"

    def add_frame(self, role: FrameRole, observation: FrameObservation) -> None:
        """Take in one more of `other_frames`."""
        if self.other_frames:
            self.other_frames.append(CallFrame(role, observation))
        else:
            self.other_frames = [CallFrame(role, observation)]

    @property
    def is_plain(self) -> bool:
        """Whether it is nothing but a first request and perhaps its reply."""
        return not self.other_frames and self.first_attempt_seen

    @property
    def first_attempt_seen(self) -> bool:
        """Whether the first try was seen; otherwise `request` is a retry and the call began before."""
        frame = self.request.item
        return frame.reserved in (0, frame.serial) or self.conversation.transport is Transport.TCP

    @property
    def attempts(self) -> tuple[FrameObservation, ...]:
        """All tries that were seen, the first one first."""
        return (
            (self.request, *self._frames_with_role(FrameRole.RETRY)) if self.other_frames else (self.request,)
        )

    @property
    def retries(self) -> int:
        """How many of `attempts` are not the first try."""
        return len(self.attempts) - self.first_attempt_seen

    @property
    def late_replies(self) -> tuple[FrameObservation, ...]:
        """Replies that the client discarded, if it goes by the serial of its last request as it should."""
        return self._frames_with_role(FrameRole.LATE)

    @property
    def lost_replies(self) -> tuple[FrameObservation, ...]:
        """Replies that were seen in time and did not keep the client from asking again."""
        return self._frames_with_role(FrameRole.LOST)

    @property
    def notices(self) -> tuple[FrameObservation, ...]:
        """S_EXECUTING notices."""
        return self._frames_with_role(FrameRole.NOTICE)

    @property
    def duplicates(self) -> tuple[FrameObservation, ...]:
        """Exact copies of requests and replies."""
        return self._frames_with_role(FrameRole.DUPLICATE)

    @property
    def frames(self) -> tuple[CallFrame, ...]:
        """Every frame of the call with its role, in the order in which they were seen."""
        reply = () if self.reply is None else (CallFrame(FrameRole.REPLY, self.reply),)
        first = CallFrame(FrameRole.REQUEST if self.first_attempt_seen else FrameRole.RETRY, self.request)
        events = (first, *self.other_frames, *reply)
        return tuple(sorted(events, key=lambda event: event.observation.number))

    @property
    def serials(self) -> tuple[int, ...]:
        """Serial of each of `attempts`."""
        return tuple(request.item.serial for request in self.attempts)

    @property
    def hresult(self) -> int | None:
        """Result in the accepted reply, unsigned."""
        return None if self.reply is None else self.reply.item.code

    @property
    def latency(self) -> int | None:
        """Nanoseconds from the first request to the accepted reply."""
        return None if self.reply is None else self.reply.time - self.request.time

    @property
    def rtt(self) -> int | None:
        """Nanoseconds from the request that was answered to the accepted reply."""
        if self.reply is None or not self.other_frames:
            return self.latency
        return self.reply.time - self.attempt_answered_by(self.reply).time

    def attempt_answered_by(self, reply: FrameObservation) -> FrameObservation:
        """Return the try that a reply of the call answers."""
        serial = reply.item.serial
        tries = (request for request in reversed(self.attempts) if request.item.serial == serial)
        return next(tries, self.request)

    @property
    def convention(self) -> ReservedConvention:
        """How the client uses the reserved field."""
        return self.reserved_usage.convention

    @property
    def reply_reserved(self) -> ReplyReserved:
        """How the server uses the reserved field."""
        return self.reserved_usage.reply_reserved

    @property
    def surely_unanswered(self) -> bool:
        """Whether it is certain that the client will have no reply."""
        return (bool(self.abandoned_at) or self.no_reply_expected) and not self.evicted

    @property
    def outcome(self) -> Outcome:
        """How the call ended for the client."""
        return outcome_of(self)

    @property
    def verdict(self) -> CallVerdict:
        """What the call suffered on the way."""
        return verdict_of(self)

    def _frames_with_role(self, role: FrameRole) -> tuple[FrameObservation, ...]:
        if not self.other_frames:
            return ()
        return tuple(event.observation for event in self.other_frames if event.role is role)


@dataclass(frozen=True, slots=True)
class StrayReply:
    """A reply or notice that belongs to no call that is still open.

    Attributes:
        observation: the frame.
        call_number: the call that it comes too late for, where that is still known; None where the request
            was never seen, or too long ago.
        may_answer_evicted: it may be what a call waited for that was let go, perhaps of `call_number`, and so
            neither late nor without a request.
    """

    observation: FrameObservation
    call_number: int | None
    may_answer_evicted: bool = False


PairingResult: TypeAlias = Call | StrayReply
"""What a tracker gives out."""
