"""The intercept: it holds messages until the user forwards, edits or drops them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

from bcapscope.faults.attempt_counter import AttemptCounter, AttemptedCall
from bcapscope.faults.quantities import FrameCondition
from bcapscope.faults.rewriter import with_header
from bcapscope.faults.wire_message import WireMessage
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.protocol.guard import always_passes
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.filter.getters import FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport
from bcapscope.traffic.pairing_windows import RETRY_WITHIN_NS

MAX_HELD = 1000
"""Maximum number of held messages. Above this limit, the proxy forwards messages immediately, with a note."""

MAX_BYTES = 16 << 20
"""Maximum total size of all held messages in bytes."""

HOLD_TIME_NS = 60_000_000_000
"""Default time in ns for which the proxy holds a message: long enough to edit it."""

_Subject: TypeAlias = tuple[AttemptedCall, Direction]
"""All attempts of one UDP call, or all replies to these attempts. A decision of the user about one of these
messages applies to all of them.
"""


@dataclass(eq=False, slots=True)
class HeldMessage:
    """A held message. Times are in ns.

    Attributes:
        data: Bytes of the latest attempt, because the client accepts only a reply to this attempt.
        call_kind: Function and command that the message calls or answers; None if unknown.
        until: Time at which the proxy forwards the message, or drops it if the client no longer waits.
        repeats: Number of later messages with the same `subject`.
        subject: What the user's decision applies to; None if it applies only to this message.
        abandoned_because: Evidence in the client's traffic that the client no longer waits.
    """

    number: int
    client: int
    flow: Flow
    data: bytes
    call_kind: CallKind | None
    since: int
    until: int
    last_attempt_at: int
    repeats: int = 0
    subject: _Subject | None = None
    abandoned_because: Message | None = None

    def abandonment_reason(self, now: int) -> Message | None:
        """Return the evidence that the client no longer waits for a reply; None without evidence.

        A motion is dangerous if it starts long after the client reported a failure to its user. A client
        makes one call at a time, so the client no longer waits after a new request or the end of its stream.
        A UDP client also no longer waits if it has sent no retry for `RETRY_WITHIN_NS`. Over TCP, clients
        never retry.
        """
        if self.abandoned_because is not None or self.flow.direction is Direction.RESPONSE:
            return self.abandoned_because
        if self.flow.conversation.transport is Transport.TCP or now - self.last_attempt_at <= RETRY_WITHIN_NS:
            return None
        return Message("held.no-retry", time=f"{(now - self.last_attempt_at) / 1e9:.1f} s")


InterceptResult: TypeAlias = tuple[Message, bytes | None]
"""A note for the user, and the bytes to forward now. The bytes are None for a held or dropped message."""


@dataclass(frozen=True, slots=True)
class _PastDecision:
    """The user's decision about a message. Retries of the message may still arrive until `until` in ns.
    `data` replaces each retry; None forwards the retries unchanged, b"" drops the retries.
    """

    number: int
    data: bytes | None
    until: int


class Intercept:
    """Holds the messages that match a filter, for at most `hold_time` ns; stops are never held. Each call is
    held once, and the user's decision also applies to the retries of the call.
    """

    def __init__(self, condition: FrameCondition | None = None, hold_time: int = HOLD_TIME_NS) -> None:
        self.hold_time = hold_time
        self.held_so_far = 0
        self._held: dict[int, HeldMessage] = {}
        # new and extended decisions move to the end, so the first decision in the dict expires first
        self._past_decisions: BoundedDict[_Subject, _PastDecision] = BoundedDict(MAX_HELD)
        self._attempts = AttemptCounter()
        self.set_condition(condition)

    def set_condition(self, condition: FrameCondition | None) -> None:
        """Change the filter for the messages to hold; None selects no message. Held messages stay held."""
        self.condition = condition
        self._matches_frame: Callable[[AnnotatedFrame], bool] | None = None
        if condition is not None:
            self._matches_frame = condition.filter.bind(FRAME_GETTERS)

    @property
    def is_idle(self) -> bool:
        """Whether the intercept can ignore all messages."""
        return self.condition is None and not self._held and not self._past_decisions

    @property
    def held(self) -> list[HeldMessage]:
        return list(self._held.values())

    @property
    def is_full(self) -> bool:
        held = sum(len(held.data) for held in self._held.values())
        return len(self._held) >= MAX_HELD or held >= MAX_BYTES

    def hold_or_pass(self, client: int, message: WireMessage) -> InterceptResult | None:
        """Decide whether to hold a message. Return None if the intercept ignores the message. Call this
        method for all messages, in order.
        """
        while self._past_decisions and next(iter(self._past_decisions.values())).until < message.now:
            del self._past_decisions[next(iter(self._past_decisions))]
        subject, is_first = self._subject(message)
        if subject is not None:
            known, decided = self._held_of(subject), self._past_decisions.get(subject)
            if known is not None:
                known.data, known.last_attempt_at = message.data, message.now
                known.repeats += 1
                return Message("held.with", number=known.number), None
            if decided is not None:
                return self._repeat_decision(message, subject, decided)
        if is_first and message.flow.direction is Direction.REQUEST:
            self.mark_abandoned(message.flow, Message("held.other-request"))
        if not self._should_hold(message):
            return None
        if self.is_full:
            return Message("held.full", count=len(self._held)), message.data
        self.held_so_far += 1
        self._held[self.held_so_far] = HeldMessage(
            self.held_so_far,
            client,
            message.flow,
            message.data,
            message.call_kind,
            message.now,
            message.now + self.hold_time,
            message.now,
            subject=subject,
        )
        return Message("held.as", number=self.held_so_far), None

    def release(self, number: int, now: int, data: bytes | None = None) -> HeldMessage:
        """Stop holding a message and return it. `data` replaces later retries; None forwards the retries
        unchanged, b"" drops the retries. If no message with this number is held, raise a `KeyError`.
        """
        held = self._held.pop(number)
        if held.subject is not None:
            self._past_decisions[held.subject] = _PastDecision(number, data, now + RETRY_WITHIN_NS)
        return held

    def due(self) -> int | None:
        return min((held.until for held in self._held.values()), default=None)

    def pop_expired(self, now: int) -> list[HeldMessage]:
        """Release and return the messages that were held for the maximum time. If the client of a message no
        longer waits, drop later retries of the message.
        """
        return [
            self.release(held.number, now, None if held.abandonment_reason(now) is None else b"")
            for held in self.held
            if held.until <= now
        ]

    def mark_abandoned(self, flow: Flow, why: Message) -> None:
        for held in self.held:
            if held.flow is flow and held.abandoned_because is None:
                held.abandoned_because = why

    def holds(self, flow: Flow) -> bool:
        return any(held.flow is flow for held in self._held.values())

    def remove_held(self, flow: Flow) -> list[HeldMessage]:
        found = [held for held in self.held if held.flow is flow]
        for held in found:
            del self._held[held.number]
        return found

    def close_conversation(self, conversation: Conversation) -> None:
        self._attempts.close_conversation(conversation)

    def _subject(self, message: WireMessage) -> tuple[_Subject | None, bool]:
        """Return the `_Subject` of a message, and whether the message is a first attempt. The `_Subject` is
        None if the user's decision applies to this message alone.
        """
        if self.is_idle or not message.is_datagram or len(message.frames) != 1:
            return None, bool(message.frames)
        (frame,), flow = message.frames, message.flow
        copied = None
        if flow.direction is Direction.REQUEST:
            copied = self._attempts.find_same_request(flow, frame)
            if copied is not None and self._held_of((copied, flow.direction)) is not None:
                return (copied, flow.direction), False
        found = self._attempts.add_frame(flow, frame)
        if found is None:
            return None, False
        return (found.call, flow.direction), found.number == 1 and copied is None

    def _held_of(self, subject: _Subject) -> HeldMessage | None:
        return next((held for held in self._held.values() if held.subject == subject), None)

    def _repeat_decision(
        self, message: WireMessage, subject: _Subject, decided: _PastDecision
    ) -> InterceptResult:
        self._past_decisions[subject] = replace(decided, until=message.now + RETRY_WITHIN_NS)
        (frame,), number = message.frames, decided.number
        if decided.data is None:
            return Message("held.sent-as", number=number), message.data
        match parse_datagram(decided.data):
            case [Frame() as edited]:
                data = with_header(edited, serial=frame.serial, reserved=frame.reserved)
                return Message("held.edited-as", number=number), data
        return Message("held.dropped-as", number=number), None

    def _should_hold(self, message: WireMessage) -> bool:
        test = self._matches_frame
        if test is None or not any(test(each) for each in message.annotated_frames):
            return False
        if message.flow.direction is Direction.RESPONSE:
            return True
        items = (each.observation.item for each in message.annotated_frames)
        return not any(always_passes(item.code, item.variants) for item in items if isinstance(item, Frame))
