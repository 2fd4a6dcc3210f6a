"""Outcome and verdict of a call, as far as the capture shows."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence, Set
from enum import StrEnum
from operator import attrgetter
from typing import TYPE_CHECKING, TypeVar

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.hresult import E_BUSY, S_EXECUTING, is_failure
from bcapscope.traffic.unseen_attempts import is_later, skipped_serials

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, FrameObservation

_FrameT = TypeVar("_FrameT", bound="FrameObservation")


class Outcome(StrEnum):
    """How a call ended for the client."""

    ANSWERED = "answered"
    """The result code reports success."""
    REFUSED = "refused"
    """The result code reports a failure."""
    UNANSWERED = "unanswered"
    """The client evidently received no reply to the call."""
    CAPTURE_ENDED = "capture_ended"
    """The capture ended before a reply; a reply may have followed."""
    NOT_FOLLOWED = "not_followed"
    """The call was evicted because too many calls were open; a reply may have followed."""
    NOT_CAPTURED = "not_captured"
    """The capture may lack the reply: it lacks bytes from the controller, or holds only requests."""


class CallVerdict(StrEnum):
    """What happened to a call. For a call without problems, the verdict equals the outcome."""

    ANSWERED = "answered"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    """No reply to any attempt was captured. Either all attempts or all replies were lost, or the controller
    did not reply."""
    CAPTURE_ENDED = "capture ended"
    NOT_FOLLOWED = "not followed"
    NOT_CAPTURED = "not captured"
    EXECUTED_TWICE = "executed twice"
    """The controller executed the call more than once. The replies to the call differ in result or value, or
    the controller skipped handles (see `Call.skipped_handles`). A server that recognises a retry sends the
    stored reply again (orin_bcap C/src/bCAPServer/bcap_server.c). DENSO Wave 2009 shows two equal replies to
    a retried call.
    """
    REPLY_LATE = "reply late"
    """A reply was captured after the client had sent the next attempt or begun another call. The client
    discarded the reply. The client's timeout is too short, or the controller or the network was too slow.
    """
    REPLY_LOST = "reply lost"
    """The client retried, although a reply was captured well before the retry (see `capture_point`). The
    reply was lost between the capture point and the client, or the client was too busy to read the reply. An
    attempt's result counts as lost if the controller sent S_EXECUTING for the attempt and the capture lacks
    the result. If a proxy recorded a reply only at the controller's side, the reply counts as lost.
    """
    REQUEST_LOST = "request lost"
    """The controller sent S_EXECUTING for a retry, but not for the first attempt. The first attempt was
    therefore lost before it reached the controller. If a proxy recorded an attempt only at the client's side,
    the attempt counts as lost. An attempt counts as lost if a capture at the controller lacks both the
    attempt and its reply. If a call lost both requests and replies, the first loss determines the verdict.
    """
    CANNOT_TELL = "cannot tell"
    """The client retried, and the capture does not show whether requests or replies were lost, or whether a
    reply was late. `tests/traffic/possible_worlds.py` finds all sequences of events that give the same
    capture.
    """


_NO_RESULTS = (E_BUSY, S_EXECUTING)
_VERDICT_OF_OUTCOME = {outcome: CallVerdict[outcome.name] for outcome in Outcome}


def outcome_of(call: Call) -> Outcome:
    reply = call.reply
    if reply is not None:
        return Outcome.REFUSED if is_failure(reply.item.code) else Outcome.ANSWERED
    if call.evicted:
        return Outcome.NOT_FOLLOWED
    if call.reply_not_captured:
        return Outcome.NOT_CAPTURED
    return Outcome.UNANSWERED if call.surely_unanswered else Outcome.CAPTURE_ENDED


def verdict_of(call: Call) -> CallVerdict:
    """Return the verdict on a call, according to the strongest evidence in its frames."""
    if call.is_plain:
        outcome = outcome_of(call)
        if outcome is Outcome.UNANSWERED and call.lost_between:
            return CallVerdict.REQUEST_LOST
        return _VERDICT_OF_OUTCOME[outcome]
    return _by_frames(call)


def _by_frames(call: Call) -> CallVerdict:
    if call.skipped_handles or _replies_differ(call):
        return CallVerdict.EXECUTED_TWICE
    if _sure(call, call.late_replies):
        return CallVerdict.REPLY_LATE
    lost_between = [
        seen
        for seen in call.lost_between
        if isinstance(seen.item, Frame) and call.surely_has(seen.item.serial)
    ]
    if lost_between and (call.retries or call.reply is None):
        return CallVerdict.REQUEST_LOST if lost_between[0].is_request else CallVerdict.REPLY_LOST
    lost = [reply for reply in _sure(call, _lost_replies(call)) if reply.item.code != S_EXECUTING]
    if lost and not may_have_crossed(call, lost):
        return CallVerdict.REPLY_LOST
    if lost or (call.retries and (call.reply is not None or call.may_go_on)):
        return _by_attempts(call, lost)
    return _VERDICT_OF_OUTCOME[outcome_of(call)]


def _by_attempts(call: Call, lost: Sequence[FrameObservation]) -> CallVerdict:
    """Infer the verdict on a retried call. A controller executes the first attempt that arrives, and answers
    each attempt in order.
    """
    answered = {reply.item.serial for reply in lost}
    if call.reply is not None:
        answered.add(call.reply.item.serial)
    strays = (notice for notice in call.stray_replies if notice.item.code == S_EXECUTING)
    noticed = {notice.item.serial for notice in _sure(call, (*call.notices, *strays))}
    if noticed - answered and (answered or call.was_overtaken):
        return CallVerdict.REPLY_LOST
    first = call.request.item.serial if call.first_attempt_seen else call.request.item.reserved
    if (noticed and first not in noticed) or _is_unseen_lost(call, answered | noticed):
        return CallVerdict.REQUEST_LOST
    return CallVerdict.CANNOT_TELL


def _is_unseen_lost(call: Call, received: Set[int]) -> bool:
    """Return whether an uncaptured attempt evidently did not reach the controller. The evidence is that a
    capture at the controller lacks every reply to this attempt, but has a reply or notice for a later
    attempt. A capture at the controller normally has every reply. `received` holds the serials of the
    attempts with replies or notices.
    """
    return call.is_at_controller and any(
        serial not in received and any(is_later(each, serial) for each in received)
        for serial in call.all_unseen_serials
    )


def _lost_replies(call: Call) -> tuple[FrameObservation, ...]:
    return (*call.stray_replies, *call.lost_replies) if call.stray_replies else call.lost_replies


def _sure(call: Call, frames: Sequence[_FrameT]) -> list[_FrameT]:
    return [frame for frame in frames if call.surely_has(frame.item.serial)]


def _replies_differ(call: Call) -> bool:
    """Return whether the call's undamaged replies differ. Ignore replies with E_BUSY or S_EXECUTING, because
    they hold no result of the call.
    """
    accepted = () if call.reply is None else (call.reply,)
    replies = _sure(call, (*accepted, *call.late_replies, *_lost_replies(call)))
    frames = [reply.item for reply in replies if not reply.item.problems]
    contents = {
        frame.raw[9:] for frame in frames if frame.code not in _NO_RESULTS and frame.external_problem is None
    }
    return len(contents) > 1


def may_have_crossed(call: Call, replies: Sequence[FrameObservation]) -> bool:
    """Return whether each reply in `replies` may have crossed the client's next attempt on the network. If
    skipped serials show that this attempt was not captured, the reply may have crossed it.
    """
    attempts = sorted(call.attempts, key=attrgetter("time"))
    times = [each.time for each in attempts]
    for reply in replies:
        index = bisect_left(times, reply.time)
        if index == len(attempts):
            return False
        after = attempts[index]
        is_soon = after.time - reply.time <= call.crossing_ns
        if not is_soon and not skipped_serials(reply.item.serial, after.item.serial):
            return False
    return True
