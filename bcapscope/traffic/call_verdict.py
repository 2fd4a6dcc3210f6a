"""Outcome and verdict of a call, as far as one capture point can tell."""

from __future__ import annotations

from bisect import bisect_left
from enum import StrEnum
from typing import TYPE_CHECKING

from bcapscope.protocol.tables.hresult import E_BUSY, is_failure

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, FrameObservation

CROSSING_NS = 500_000
"""Window in which a reply and a retry, captured one after the other, may have crossed on the network, ns. A
round trip on a factory network takes less."""


class Outcome(StrEnum):
    """How a call ended for the client."""

    ANSWERED = "answered"
    """The result code reports success."""
    REFUSED = "refused"
    """The result code reports a failure."""
    UNANSWERED = "unanswered"
    """The client moved on without a reply, no reply came for a very long time, or the connection ended."""
    CAPTURE_ENDED = "capture_ended"
    """The capture ended first; a reply may have followed."""
    NOT_FOLLOWED = "not_followed"
    """The call was evicted because too many calls were open; a reply may have followed."""


class CallVerdict(StrEnum):
    """What happened to a call. For a call without trouble, the verdict equals the outcome."""

    ANSWERED = "answered"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    """No reply to any attempt was captured. Every attempt or every reply may be lost, or the controller may
    be silent."""
    CAPTURE_ENDED = "capture ended"
    NOT_FOLLOWED = "not followed"
    EXECUTED_TWICE = "executed twice"
    """Replies to the attempts of one call differ in result or arguments. A server that recognises a retry
    sends the stored reply again (orin_bcap C/src/bCAPServer/bcap_server.c; the two replies in DENSO Wave 2009
    are equal as well). Or the accepted handle skips numbers, at most as many as there are unanswered
    attempts. The controller then created objects whose handles the client never received."""
    REPLY_LATE = "reply late"
    """A reply was captured after the client had sent the next attempt or moved on to another call, and so the
    client discarded it. The client's timeout is too short, or the controller or the network took too long."""
    REPLY_LOST = "reply lost"
    """A reply was captured, yet the client sent another attempt. The reply was lost between the capture point
    and the client, or the client was too busy to read it. Or S_EXECUTING was captured for an attempt whose
    result never came."""
    REQUEST_LOST = "request lost"
    """S_EXECUTING was captured for the answered attempt and nothing for the earlier ones. The controller
    executed that attempt; had it received an earlier one, it would have executed or answered that one."""
    CANNOT_TELL = "cannot tell"
    """The client retried, and the capture does not show whether requests or replies were lost."""


_VERDICT_OF_OUTCOME = {outcome: CallVerdict[outcome.name] for outcome in Outcome}


def outcome_of(call: Call) -> Outcome:
    reply = call.reply
    if reply is not None:
        return Outcome.REFUSED if is_failure(reply.item.code) else Outcome.ANSWERED
    if call.evicted:
        return Outcome.NOT_FOLLOWED
    return Outcome.UNANSWERED if call.surely_unanswered else Outcome.CAPTURE_ENDED


def verdict_of(call: Call) -> CallVerdict:
    """Return the verdict on a call; the strongest evidence decides."""
    if call.is_plain:
        return _VERDICT_OF_OUTCOME[outcome_of(call)]
    if call.skipped_handles or _replies_differ(call):
        return CallVerdict.EXECUTED_TWICE
    if call.late_replies:
        return CallVerdict.REPLY_LATE
    if call.lost_replies:
        return CallVerdict.CANNOT_TELL if _all_crossed(call) else CallVerdict.REPLY_LOST
    if call.reply is None or not call.retries:
        return _VERDICT_OF_OUTCOME[outcome_of(call)]
    return _by_notices(call, call.reply)


def _by_notices(call: Call, reply: FrameObservation) -> CallVerdict:
    """Judge an answered call with retries by the attempts that got an S_EXECUTING notice."""
    noticed = {notice.item.serial for notice in call.notices}
    if noticed - {reply.item.serial}:
        return CallVerdict.REPLY_LOST
    return CallVerdict.REQUEST_LOST if noticed else CallVerdict.CANNOT_TELL


def _replies_differ(call: Call) -> bool:
    """Compare result and arguments of all replies that are undamaged and completely captured.

    Replies with E_BUSY are left out: they do not show whether the controller executed this call.
    """
    replies = (call.reply, *call.late_replies, *call.lost_replies)
    frames = [reply.item for reply in replies if reply is not None and not reply.item.problems]
    contents = {frame.raw[9:] for frame in frames if frame.code != E_BUSY and frame.external_problem is None}
    return len(contents) > 1


def _all_crossed(call: Call) -> bool:
    """Tell whether every lost reply may have crossed the next attempt on the network."""
    asked = sorted(request.time for request in call.attempts)
    lost = [(reply.time, bisect_left(asked, reply.time)) for reply in call.lost_replies]
    return all(after < len(asked) and asked[after] - time <= CROSSING_NS for time, after in lost)
