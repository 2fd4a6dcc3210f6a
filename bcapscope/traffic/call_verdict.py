"""What became of a call, as far as one place of capture can tell."""

from __future__ import annotations

from bisect import bisect_left
from enum import StrEnum
from typing import TYPE_CHECKING

from bcapscope.protocol.tables.hresult import E_BUSY, is_failure

if TYPE_CHECKING:
    from bcapscope.traffic.call import Call, FrameObservation

CROSSING_NS = 500_000
"""A reply and a retry that pass the place of capture within this time of each other may have been on their
way at once: a round trip on a factory's network takes less."""


class Outcome(StrEnum):
    """How a call ended for the client."""

    ANSWERED = "answered"
    """With a result that is no failure."""
    REFUSED = "refused"
    """With a result that is a failure."""
    UNANSWERED = "unanswered"
    """The client asked for something else without having had a reply, or none came in a very long time, or
    the connection was gone."""
    CAPTURE_ENDED = "capture_ended"
    """The traffic ended first; the client may have had its reply afterwards."""
    NOT_FOLLOWED = "not_followed"
    """More was open than is kept in mind, so that nobody looked any further; the client may have had its
    reply afterwards."""


class CallVerdict(StrEnum):
    """What a call suffered on the way; for calls without trouble the same as their outcome."""

    ANSWERED = "answered"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    """No reply to any try was seen. Every try or every reply may be lost, or the server silent."""
    CAPTURE_ENDED = "capture ended"
    NOT_FOLLOWED = "not followed"
    EXECUTED_TWICE = "executed twice"
    """Replies to the tries of one call differ in result or arguments. A server that knows a retry for one
    sends the stored answer again (orin_bcap C/src/bCAPServer/bcap_server.c; the two replies in DENSO Wave
    2009 are equal as well). Or the handle that came back skips as many numbers as tries went unanswered,
    or fewer: objects were made that the client never heard of."""
    REPLY_LATE = "reply late"
    """A reply to a try was seen after the client had sent the next one, or had gone on to another call, and
    so was discarded: the client waits too short a time, or the server or the network took too long."""
    REPLY_LOST = "reply lost"
    """A reply was seen and yet the client asked again, so it was lost between here and the client (or the
    client was too busy to take it). Or S_EXECUTING was seen for a try whose result never came."""
    REQUEST_LOST = "request lost"
    """S_EXECUTING was seen for the try that was answered and nothing for those before: the server executed
    that one, while a server that had received an earlier one would have executed or answered that."""
    CANNOT_TELL = "cannot tell"
    """Tried again, and nothing that was seen tells whether requests or replies were lost."""


_VERDICT_OF_OUTCOME = {outcome: CallVerdict[outcome.name] for outcome in Outcome}


def outcome_of(call: Call) -> Outcome:
    """Tell how a call ended for the client."""
    reply = call.reply
    if reply is not None:
        return Outcome.REFUSED if is_failure(reply.item.code) else Outcome.ANSWERED
    if call.evicted:
        return Outcome.NOT_FOLLOWED
    return Outcome.UNANSWERED if call.surely_unanswered else Outcome.CAPTURE_ENDED


def verdict_of(call: Call) -> CallVerdict:
    """Judge a call; the strongest evidence decides."""
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
    """Judge a call that was answered and had retries by the tries for which S_EXECUTING was seen."""
    noticed = {notice.item.serial for notice in call.notices}
    if noticed - {reply.item.serial}:
        return CallVerdict.REPLY_LOST
    return CallVerdict.REQUEST_LOST if noticed else CallVerdict.CANNOT_TELL


def _replies_differ(call: Call) -> bool:
    """Compare result and arguments of all replies that are sound, and that the capture holds whole.

    That the server was busy with another call says nothing about whether this one was executed.
    """
    replies = (call.reply, *call.late_replies, *call.lost_replies)
    frames = [reply.item for reply in replies if reply is not None and not reply.item.problems]
    contents = {frame.raw[9:] for frame in frames if frame.code != E_BUSY and frame.external_problem is None}
    return len(contents) > 1


def _all_crossed(call: Call) -> bool:
    """Tell whether each reply that was not heeded may have met the next try on its way."""
    asked = sorted(request.time for request in call.attempts)
    lost = [(reply.time, bisect_left(asked, reply.time)) for reply in call.lost_replies]
    return all(after < len(asked) and asked[after] - time <= CROSSING_NS for time, after in lost)
