"""What became of a call, as far as one place of capture can tell."""

from __future__ import annotations

from bisect import bisect_left
from enum import StrEnum
from typing import TYPE_CHECKING

from bcapscope.protocol.hresult import E_BUSY, is_failure

if TYPE_CHECKING:
    from bcapscope.traffic.exchange import Exchange, FrameObservation

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


class Verdict(StrEnum):
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


_AS_OUTCOME = {outcome: Verdict[outcome.name] for outcome in Outcome}


def outcome_of(exchange: Exchange) -> Outcome:
    """Tell how a call ended for the client."""
    reply = exchange.reply
    if reply is not None:
        return Outcome.REFUSED if is_failure(reply.item.code) else Outcome.ANSWERED
    if exchange.let_go:
        return Outcome.NOT_FOLLOWED
    return Outcome.UNANSWERED if exchange.given_up else Outcome.CAPTURE_ENDED


def verdict_of(exchange: Exchange) -> Verdict:
    """Judge a call; the strongest evidence decides."""
    if exchange.is_plain:
        return _AS_OUTCOME[outcome_of(exchange)]
    if exchange.skipped_handles or _replies_differ(exchange):
        return Verdict.EXECUTED_TWICE
    if exchange.late_replies:
        return Verdict.REPLY_LATE
    if exchange.lost_replies:
        return Verdict.CANNOT_TELL if _all_crossed(exchange) else Verdict.REPLY_LOST
    if exchange.reply is None or not exchange.retries:
        return _AS_OUTCOME[outcome_of(exchange)]
    return _by_notices(exchange, exchange.reply)


def _by_notices(exchange: Exchange, reply: FrameObservation) -> Verdict:
    """Judge a call that was answered and had retries by the tries for which S_EXECUTING was seen."""
    noticed = {notice.item.serial for notice in exchange.notices}
    if noticed - {reply.item.serial}:
        return Verdict.REPLY_LOST
    return Verdict.REQUEST_LOST if noticed else Verdict.CANNOT_TELL


def _replies_differ(exchange: Exchange) -> bool:
    """Compare result and arguments of all replies that are sound, and that the capture holds whole.

    That the server was busy with another call says nothing about whether this one was executed.
    """
    replies = (exchange.reply, *exchange.late_replies, *exchange.lost_replies)
    frames = [reply.item for reply in replies if reply is not None and not reply.item.problems]
    contents = {frame.raw[9:] for frame in frames if frame.code != E_BUSY and frame.note is None}
    return len(contents) > 1


def _all_crossed(exchange: Exchange) -> bool:
    """Tell whether each reply that was not heeded may have met the next try on its way."""
    asked = sorted(request.time for request in exchange.requests)
    lost = [(reply.time, bisect_left(asked, reply.time)) for reply in exchange.lost_replies]
    return all(after < len(asked) and asked[after] - time <= CROSSING_NS for time, after in lost)
