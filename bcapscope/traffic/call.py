"""A call: a request with its retries, notices and replies, and the verdict on what happened."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol, TypeAlias

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import S_EXECUTING
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import CallVerdict, Outcome, outcome_of, verdict_of
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Conversation, Flow, Transport
from bcapscope.traffic.reserved_field import ReplyReserved, ReservedConvention, ReservedFieldUsage
from bcapscope.traffic.unseen_attempts import is_later


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
    """Role of a frame in the call that it belongs to."""

    REQUEST = "request"
    """The first attempt of the call."""
    RETRY = "retry"
    NOTICE = "executing"
    """S_EXECUTING: the controller is still working on the request."""
    REPLY = "reply"
    """The reply that the client accepted."""
    LATE = "late reply"
    """A reply that arrived after the client sent another attempt or began another call. If two replies to the
    latest attempt differ, the second reply has the role `LATE`.
    """
    LOST = "lost reply"
    """A reply that was captured before the client sent another attempt. The client evidently did not receive
    the reply, because the client retried.
    """
    DUPLICATE = "duplicate"
    """An exact copy of an earlier request or reply of the same call. The network or the capture made the
    copy, because all known clients give a retry a new serial."""
    CAPTURED_AGAIN = "captured again"
    """An exact copy of an earlier frame of the same call. The time between the two frames is so short that
    the capture probably holds one packet twice. The copy may come from a second interface or a mirror port.
    """


class CallState(StrEnum):
    """State of a call. `pairing_states` defines the transitions between the states."""

    WAITING = "waiting"
    EXECUTING = "executing"
    """The controller has sent S_EXECUTING, and the client waits for the reply."""
    ANSWERED = "answered"
    ABANDONED = "abandoned"
    """The client began another call before it received a reply to this call."""
    UNANSWERED = "unanswered"
    """Complete without a reply: a reply can no longer follow, or the traffic has ended."""
    SETTLED = "settled"
    """Complete: no further frame can belong to the call."""
    EVICTED = "evicted"
    """The tracker completed the call early, to limit memory. A reply to the call could still follow."""


_WAITING = CallState.WAITING


class CallFrame(NamedTuple):
    """A frame of a call, and its role in the call."""

    role: FrameRole
    observation: FrameObservation


# `Call` has its own `__init__`, because the `__init__` that `dataclass` generates would be slower.
@dataclass(slots=True, init=False, repr=False, eq=False)
class Call:
    """A call, as far as it was captured. All calls that `Capture.calls` yields are complete.

    Attributes:
        conversation: Client, controller and transport.
        kind: Function and command of the call.
        number: Number of the call in starting order, counted from 1 over all conversations.
        reply_missed: Whether the capture may lack the reply: bytes from the controller are missing, or the
            capture holds only requests.
        request: First attempt of the call or, if it was not captured, the first captured retry.
        reply: Reply that the client accepted; None if no such reply was captured.
        last_attempt: Latest attempt of the call, the only one to which the client accepts a reply.
        other_frames: All frames of the call except `request` and `reply`, in capture order.
        abandoned_at: Time when the client began another call before it received a reply to this call, ns
            since 1970; 0 if the client began no such call. If the reply came after the client's timeout,
            `abandoned_at` is the time of the timeout.
        gave_up_inferred: Whether bcapscope inferred `abandoned_at` only from the times between the attempts.
        sure_until: Serial of the latest attempt that surely belongs to this call; None if all captured
            attempts surely belong to this call.
        may_go_on: Whether this call may have attempts after `last_attempt`: uncaptured attempts, or attempts
            that bcapscope counts as a newer call. The client may have received a reply to such an attempt.
        may_continue_in: Newer call whose attempts may be retries of this call; None in a complete call.
        was_overtaken: Whether the controller answered a request that is newer than this call's captured
            attempts; always False if `may_go_on` is False.
        stray_replies: Replies and notices that answer uncaptured attempts of this call. bcapscope also
            reports each frame in `stray_replies` as a stray reply, because the call of the frame was unknown
            at first.
        is_at_controller: Whether the user says that the capture was taken at the controller.
        last_activity: Time of the latest frame of the call, ns since 1970.
        no_reply_expected: True if no reply can follow, and the client has not yet begun its next call.
        state: State of the call; a complete call is unanswered, settled or evicted.
        crossing_ns: Maximum time in ns between a reply and a retry that may have crossed on the network, for
            this client. bcapscope determines this time when the call becomes complete.
        skipped_handles: Number of handles that the controller skipped before it gave the handle in the
            accepted reply. Each skipped handle shows one more execution of the call. A call with n captured
            attempts explains at most n - 1 skipped handles. If the controller skipped more handles,
            `skipped_handles` is 0.
        unseen_serials: Serials of the retries that were not captured, inferred from the serials around them.
        reserved_usage: How client and controller used the reserved field, as far as known when the call
            became complete.
        memory_bytes: Size in bytes of the call's frames and their overhead, as counted by
            `ConversationPairing`.
    """

    number: int
    conversation: Conversation
    kind: CallKind
    request: FrameObservation
    last_attempt: FrameObservation
    last_activity: int
    reserved_usage: ReservedFieldUsage
    reply: FrameObservation | None
    other_frames: list[CallFrame] | tuple[()]
    abandoned_at: int
    gave_up_inferred: bool
    no_reply_expected: bool
    reply_missed: bool
    may_go_on: bool
    may_continue_in: Call | None
    was_overtaken: bool
    is_at_controller: bool
    sure_until: int | None
    state: CallState
    skipped_handles: int
    memory_bytes: int
    crossing_ns: int
    unseen_serials: tuple[int, ...]
    stray_replies: tuple[FrameObservation, ...]

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
        self.reply = None
        self.other_frames = ()  # nearly all calls share the empty tuple, which saves memory
        self.abandoned_at = 0
        self.no_reply_expected = self.gave_up_inferred = False
        self.reply_missed = self.may_go_on = self.was_overtaken = self.is_at_controller = False
        self.may_continue_in = self.sure_until = None
        self.state = _WAITING
        self.skipped_handles = self.memory_bytes = self.crossing_ns = 0
        self.unseen_serials = self.stray_replies = ()

    def __repr__(self) -> str:
        events = ", ".join(f"{event.role} {event.observation.number}" for event in self.frames)
        return f"Call({self.number}, {self.kind.function_id}, {self.kind.command!r}: {events})"

    def add_frame(self, role: FrameRole, observation: FrameObservation) -> None:
        if self.other_frames:
            self.other_frames.append(CallFrame(role, observation))
        else:
            self.other_frames = [CallFrame(role, observation)]

    @property
    def function(self) -> str:
        """Name of the function, such as `Robot_Execute`."""
        return function_name(self.kind.function_id)

    @property
    def command(self) -> str | None:
        """Command of an Execute function, such as `slvMove`; None for any other function."""
        return self.kind.command

    @property
    def evicted(self) -> bool:
        """Whether the tracker evicted the call to limit memory, although a reply could still follow."""
        return self.state is CallState.EVICTED

    @property
    def is_plain(self) -> bool:
        """Whether the call has no frames except a first attempt and at most one reply."""
        return not self.other_frames and self.first_attempt_seen

    @property
    def first_attempt_seen(self) -> bool:
        """Whether the first attempt of the call was captured. If False, `request` is a retry."""
        frame = self.request.item
        return frame.reserved in (0, frame.serial) or self.conversation.transport is Transport.TCP

    @property
    def attempts(self) -> tuple[FrameObservation, ...]:
        """All captured attempts of the call, oldest first."""
        if not self.other_frames:
            return (self.request,)
        return (self.request, *self._frames_with_role(FrameRole.RETRY))

    @property
    def retries(self) -> int:
        """Number of captured retries of the call."""
        return len(self.attempts) - self.first_attempt_seen

    @property
    def unseen_retries(self) -> int:
        """Number of retries of the call that were not captured, as far as skipped serials show."""
        return len(self.unseen_serials)

    @property
    def latest_serial(self) -> int:
        """Serial of the latest attempt, captured or not."""
        last = self.last_attempt.item.serial
        unseen = self.unseen_serials[-1] if self.unseen_serials else last
        return unseen if is_later(unseen, last) else last

    @property
    def all_unseen_serials(self) -> tuple[int, ...]:
        """Serials of the uncaptured attempts of the call, including an uncaptured first attempt."""
        if self.first_attempt_seen:
            return self.unseen_serials
        return (self.request.item.reserved, *self.unseen_serials)

    @property
    def late_replies(self) -> tuple[FrameObservation, ...]:
        """Replies with the role `LATE`. A client that compares serials discards late replies."""
        return self._frames_with_role(FrameRole.LATE)

    @property
    def lost_replies(self) -> tuple[FrameObservation, ...]:
        """Captured replies that the client evidently did not receive (role `LOST`)."""
        return self._frames_with_role(FrameRole.LOST)

    @property
    def notices(self) -> tuple[FrameObservation, ...]:
        """Replies with S_EXECUTING: the controller was still working on the request."""
        return self._frames_with_role(FrameRole.NOTICE)

    @property
    def joined_frames(self) -> Iterator[JoinedObservation]:
        """Yield the frames of the call that were captured at two places, in capture order."""
        for event in self.frames:
            seen: object = event.observation
            if isinstance(seen, JoinedObservation):
                yield seen

    @property
    def lost_between(self) -> tuple[JoinedObservation, ...]:
        """The frames that were lost between two places of the capture, in order of time."""
        if not self.other_frames and not isinstance(self.request, JoinedObservation):
            return ()
        lost = (seen for seen in self.joined_frames if seen.was_lost_between)
        return tuple(sorted(lost, key=lambda seen: seen.time))

    @property
    def was_received(self) -> bool:
        """Whether a captured frame shows that the controller received an attempt of this call."""
        if self.reply is not None or self.stray_replies:
            return True
        return bool(self.notices or self.lost_replies or self.late_replies)

    @property
    def was_executed(self) -> bool:
        """Whether S_EXECUTING was captured for an attempt of this call."""
        return bool(self.notices) or any(each.item.code == S_EXECUTING for each in self.stray_replies)

    @property
    def duplicates(self) -> tuple[FrameObservation, ...]:
        """Exact copies of earlier requests or replies. The network or the capture made these copies."""
        return self._frames_with_role(FrameRole.DUPLICATE)

    @property
    def captured_again(self) -> tuple[FrameObservation, ...]:
        """Frames that the capture probably holds twice, although the network carried them once."""
        return self._frames_with_role(FrameRole.CAPTURED_AGAIN)

    @property
    def frames(self) -> tuple[CallFrame, ...]:
        """Every frame of the call with its role, in capture order."""
        reply = () if self.reply is None else (CallFrame(FrameRole.REPLY, self.reply),)
        first = CallFrame(FrameRole.REQUEST if self.first_attempt_seen else FrameRole.RETRY, self.request)
        events = (first, *self.other_frames, *reply)
        return tuple(sorted(events, key=lambda event: event.observation.number))

    @property
    def serials(self) -> tuple[int, ...]:
        """Serial of each captured attempt of the call, oldest first."""
        return tuple(request.item.serial for request in self.attempts)

    @property
    def hresult(self) -> int | None:
        """Result code of the accepted reply, unsigned; None if no reply was accepted."""
        return None if self.reply is None else self.reply.item.code

    @property
    def latency(self) -> int | None:
        """Time from the first attempt to the accepted reply, ns; None if no reply was accepted."""
        return None if self.reply is None else self.reply.time - self.request.time

    @property
    def rtt(self) -> int | None:
        """Time from the answered attempt to the accepted reply, ns; None if no reply was accepted."""
        if self.reply is None or not self.other_frames:
            return self.latency
        return self.reply.time - self.attempt_answered_by(self.reply).time

    def attempt_answered_by(self, reply: FrameObservation) -> FrameObservation:
        """Return the attempt that has the reply's serial, or `request` if no attempt has this serial."""
        serial = reply.item.serial
        tries = (request for request in reversed(self.attempts) if request.item.serial == serial)
        return next(tries, self.request)

    def surely_has(self, serial: int) -> bool:
        """Return whether the attempt that has this serial surely belongs to this call."""
        return self.sure_until is None or not is_later(serial, self.sure_until)

    @property
    def convention(self) -> ReservedConvention:
        """How the client fills the reserved field of its requests."""
        return self.reserved_usage.convention

    @property
    def reply_reserved(self) -> ReplyReserved:
        """How the controller fills the reserved field of its replies."""
        return self.reserved_usage.reply_reserved

    @property
    def surely_unanswered(self) -> bool:
        """Whether it is certain that the client received no reply."""
        return (
            (bool(self.abandoned_at) or self.no_reply_expected)
            and not self.evicted
            and not self.reply_not_captured
        )

    @property
    def reply_not_captured(self) -> bool:
        """Whether the client may have received a reply that the capture lacks."""
        if self.reply is not None or not (self.reply_missed or self.may_go_on):
            return False
        serial = self.last_attempt.item.serial
        return self.may_go_on or all(late.item.serial != serial for late in self.late_replies)

    @property
    def outcome(self) -> Outcome:
        """How the call ended for the client."""
        return outcome_of(self)

    @property
    def verdict(self) -> CallVerdict:
        """What happened to the call, as far as the capture shows."""
        return verdict_of(self)

    def _frames_with_role(self, role: FrameRole) -> tuple[FrameObservation, ...]:
        if not self.other_frames:
            return ()
        return tuple(event.observation for event in self.other_frames if event.role is role)


@dataclass(slots=True)
class StrayReply:
    """A reply or notice that belongs to no open call of its conversation.

    Attributes:
        call_number: Number of a complete call in which an attempt has the reply's serial; None if unknown.
        request_missed: Whether the serials show that the client sent a request that the capture lacks. The
            client's next request can make `request_missed` False: if the serial of this request equals the
            reply's serial, or is earlier, the client did not skip the reply's serial.
        may_answer_evicted: Whether the reply may belong to a call that was evicted from memory. A reply that
            may belong to an evicted call is reported neither as late nor as stray.
    """

    observation: FrameObservation
    call_number: int | None
    may_answer_evicted: bool
    request_missed: bool = False


PairingResult: TypeAlias = Call | StrayReply
"""What a `Tracker` returns: a completed call or a stray reply."""
