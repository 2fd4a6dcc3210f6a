"""A call: a request, its retries, what came back, and what is to be thought of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol, TypeAlias

from bcapscope.protocol.frame import Frame
from bcapscope.traffic.convention import Convention, Habits, ReplyReserved
from bcapscope.traffic.observation import Conversation, Flow, Transport
from bcapscope.traffic.question import Question
from bcapscope.traffic.verdict import Outcome, Verdict, outcome_of, verdict_of


class FrameObservation(Protocol):
    """An `Observation` whose item is a frame."""

    @property
    def number(self) -> int: ...
    @property
    def time(self) -> int: ...
    @property
    def began(self) -> int: ...
    @property
    def flow(self) -> Flow: ...
    @property
    def item(self) -> Frame: ...
    @property
    def packet(self) -> int: ...


class Role(StrEnum):
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


class Event(NamedTuple):
    """A frame of a call and what it is to it."""

    role: Role
    seen: FrameObservation


class Exchange:
    """A call as far as it was seen; complete once the tracker has given it out.

    Attributes:
        call: 1 for the call that started first in the traffic, and so on.
        conversation: between whom.
        question: what was asked.
        request: the first try, or the first that was seen.
        reply: the one that the client accepted; None where it had none, as far as was seen.
        last: the try that the client sent last; a reply is accepted only if it answers this one.
        others: everything else that belongs to the call, in the order in which it was seen.
        gone_on: when the client went on to another call without having had a reply; 0 where it did not.
        activity: when anything of the call was last seen.
        silent: no reply is to be expected any more, though the client was not seen to go on.
        let_go: given out without a reply while one might still come, since more was open than is kept in
            mind.
        skipped_handles: how many handles the one that came back is ahead of the next in sequence, where so
            many tries went unanswered; otherwise 0.
        habits: how the conversation used the reserved field, as far as was known when the call settled.
        weight: bytes of its frames, and what keeping them costs, as far as its lane has counted them.
    """

    __slots__ = (
        "activity",
        "call",
        "conversation",
        "gone_on",
        "habits",
        "last",
        "let_go",
        "others",
        "question",
        "reply",
        "request",
        "silent",
        "skipped_handles",
        "weight",
    )

    def __init__(
        self,
        call: int,
        conversation: Conversation,
        question: Question,
        request: FrameObservation,
        habits: Habits,
    ) -> None:
        self.call = call
        self.conversation = conversation
        self.question = question
        self.request = self.last = request
        self.activity = request.time
        self.habits = habits
        self.reply: FrameObservation | None = None
        self.others: list[Event] | tuple[()] = ()  # nearly all calls share the empty one
        self.gone_on = 0
        self.silent = self.let_go = False
        self.skipped_handles = self.weight = 0

    def __repr__(self) -> str:
        events = ", ".join(f"{event.role} {event.seen.number}" for event in self.events)
        return f"Exchange({self.call}, {self.question.function_id}, {self.question.command!r}: {events})"

    def add(self, role: Role, seen: FrameObservation) -> None:
        """Take in one more of `others`."""
        if self.others:
            self.others.append(Event(role, seen))
        else:
            self.others = [Event(role, seen)]

    @property
    def is_plain(self) -> bool:
        """Whether it is nothing but a first request and perhaps its reply."""
        return not self.others and self.origin_seen

    @property
    def origin_seen(self) -> bool:
        """Whether the first try was seen; otherwise `request` is a retry and the call began before."""
        frame = self.request.item
        return frame.reserved in (0, frame.serial) or self.conversation.transport is Transport.TCP

    @property
    def requests(self) -> tuple[FrameObservation, ...]:
        """All tries that were seen, the first one first."""
        return (self.request, *self._those(Role.RETRY)) if self.others else (self.request,)

    @property
    def retries(self) -> int:
        """How many of `requests` are not the first try."""
        return len(self.requests) - self.origin_seen

    @property
    def late_replies(self) -> tuple[FrameObservation, ...]:
        """Replies that the client discarded, if it goes by the serial of its last request as it should."""
        return self._those(Role.LATE)

    @property
    def lost_replies(self) -> tuple[FrameObservation, ...]:
        """Replies that were seen in time and did not keep the client from asking again."""
        return self._those(Role.LOST)

    @property
    def notices(self) -> tuple[FrameObservation, ...]:
        """S_EXECUTING notices."""
        return self._those(Role.NOTICE)

    @property
    def duplicates(self) -> tuple[FrameObservation, ...]:
        """Exact copies of requests and replies."""
        return self._those(Role.DUPLICATE)

    @property
    def events(self) -> tuple[Event, ...]:
        """Every frame of the call with its role, in the order in which they were seen."""
        reply = () if self.reply is None else (Event(Role.REPLY, self.reply),)
        first = Event(Role.REQUEST if self.origin_seen else Role.RETRY, self.request)
        events = (first, *self.others, *reply)
        return tuple(sorted(events, key=lambda event: event.seen.number))

    @property
    def serials(self) -> tuple[int, ...]:
        """Serial of each of `requests`."""
        return tuple(request.item.serial for request in self.requests)

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
        if self.reply is None or not self.others:
            return self.latency
        return self.reply.time - self.answered_by(self.reply).time

    def answered_by(self, reply: FrameObservation) -> FrameObservation:
        """Return the try that a reply of the call answers."""
        serial = reply.item.serial
        tries = (request for request in reversed(self.requests) if request.item.serial == serial)
        return next(tries, self.request)

    @property
    def convention(self) -> Convention:
        """How the client uses the reserved field."""
        return self.habits.convention

    @property
    def reply_reserved(self) -> ReplyReserved:
        """How the server uses the reserved field."""
        return self.habits.replies

    @property
    def given_up(self) -> bool:
        """Whether it is certain that the client will have no reply."""
        return (bool(self.gone_on) or self.silent) and not self.let_go

    @property
    def outcome(self) -> Outcome:
        """How the call ended for the client."""
        return outcome_of(self)

    @property
    def verdict(self) -> Verdict:
        """What the call suffered on the way."""
        return verdict_of(self)

    def _those(self, role: Role) -> tuple[FrameObservation, ...]:
        if not self.others:
            return ()
        return tuple(event.seen for event in self.others if event.role is role)


@dataclass(frozen=True, slots=True)
class Stray:
    """A reply or notice that belongs to no call that is still open.

    Attributes:
        seen: the frame.
        call: the call that it comes too late for, where that is still known; None where the request was never
            seen, or too long ago.
        overlooked: it may be what a call waited for that was let go, perhaps of `call`, and so neither late
            nor without a request.
    """

    seen: FrameObservation
    call: int | None
    overlooked: bool = False


Settled: TypeAlias = Exchange | Stray
"""What a tracker gives out."""
