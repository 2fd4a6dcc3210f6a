"""States of a call while its frames are captured, as a table.

`TRANSITIONS` lists for each state what each event leads to, and the role that the frame of the event gets.
Which event a frame is depends on serials, bytes and times; `ConversationPairing` decides that. A pair that
the table does not list cannot occur.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from bcapscope.traffic.call import CallState, FrameRole


class CallEvent(StrEnum):
    """What happens to a call."""

    RETRY = "retry"
    """The client sends its newest call again."""
    LATER_RETRY = "later retry"
    """The client sends the call again after it began another one."""
    OVERTAKEN_RETRY = "overtaken retry"
    """A retry arrives after a newer attempt."""
    FIRST_ATTEMPT = "first attempt"
    """The first attempt arrives after a retry of it."""
    COPY = "copy"
    """A frame of the call arrives once more."""
    NOTICE = "notice"
    """The controller sends S_EXECUTING."""
    REPLY = "reply"
    """The controller answers the latest attempt."""
    EARLIER_REPLY = "earlier reply"
    """The controller answers an attempt before the latest one."""
    NEXT_CALL = "next call"
    """The client begins another call after waiting for at least the shortest timeout."""
    EXPIRY = "expiry"
    """No further frame can belong to the call, or the traffic has ended."""
    EVICTION = "eviction"
    """The call must leave memory although a reply may follow."""


class Transition(NamedTuple):
    """What an event leads to.

    Attributes:
        role: Role of the frame; None for an event without a frame.
        reply_becomes: New role of the reply that was accepted before; None if nothing changes.
    """

    state: CallState
    role: FrameRole | None
    reply_becomes: FrameRole | None = None


_WAITING, _EXECUTING = CallState.WAITING, CallState.EXECUTING
_ANSWERED, _ABANDONED = CallState.ANSWERED, CallState.ABANDONED

TRANSITIONS: dict[tuple[CallState, CallEvent], Transition] = {
    # The client waits.
    (_WAITING, CallEvent.RETRY): Transition(_WAITING, FrameRole.RETRY),
    (_WAITING, CallEvent.LATER_RETRY): Transition(_WAITING, FrameRole.RETRY),
    (_WAITING, CallEvent.OVERTAKEN_RETRY): Transition(_WAITING, FrameRole.RETRY),
    (_WAITING, CallEvent.FIRST_ATTEMPT): Transition(_WAITING, FrameRole.REQUEST),
    (_WAITING, CallEvent.COPY): Transition(_WAITING, FrameRole.DUPLICATE),
    (_WAITING, CallEvent.NOTICE): Transition(_EXECUTING, FrameRole.NOTICE),
    (_WAITING, CallEvent.REPLY): Transition(_ANSWERED, FrameRole.REPLY),
    (_WAITING, CallEvent.EARLIER_REPLY): Transition(_WAITING, FrameRole.LATE),
    (_WAITING, CallEvent.NEXT_CALL): Transition(_ABANDONED, None),
    (_WAITING, CallEvent.EXPIRY): Transition(CallState.UNANSWERED, None),
    (_WAITING, CallEvent.EVICTION): Transition(CallState.EVICTED, None),
    # The client waits, and the controller has sent S_EXECUTING.
    (_EXECUTING, CallEvent.RETRY): Transition(_EXECUTING, FrameRole.RETRY),
    (_EXECUTING, CallEvent.LATER_RETRY): Transition(_EXECUTING, FrameRole.RETRY),
    (_EXECUTING, CallEvent.OVERTAKEN_RETRY): Transition(_EXECUTING, FrameRole.RETRY),
    (_EXECUTING, CallEvent.FIRST_ATTEMPT): Transition(_EXECUTING, FrameRole.REQUEST),
    (_EXECUTING, CallEvent.COPY): Transition(_EXECUTING, FrameRole.DUPLICATE),
    (_EXECUTING, CallEvent.NOTICE): Transition(_EXECUTING, FrameRole.NOTICE),
    (_EXECUTING, CallEvent.REPLY): Transition(_ANSWERED, FrameRole.REPLY),
    (_EXECUTING, CallEvent.EARLIER_REPLY): Transition(_EXECUTING, FrameRole.LATE),
    (_EXECUTING, CallEvent.NEXT_CALL): Transition(_ABANDONED, None),
    (_EXECUTING, CallEvent.EXPIRY): Transition(CallState.UNANSWERED, None),
    (_EXECUTING, CallEvent.EVICTION): Transition(CallState.EVICTED, None),
    # A client that retries an answered call did not receive the reply, unless it has begun another call.
    (_ANSWERED, CallEvent.RETRY): Transition(_WAITING, FrameRole.RETRY, reply_becomes=FrameRole.LOST),
    (_ANSWERED, CallEvent.LATER_RETRY): Transition(_ANSWERED, FrameRole.RETRY),
    (_ANSWERED, CallEvent.OVERTAKEN_RETRY): Transition(_ANSWERED, FrameRole.RETRY),
    (_ANSWERED, CallEvent.FIRST_ATTEMPT): Transition(_ANSWERED, FrameRole.REQUEST),
    (_ANSWERED, CallEvent.COPY): Transition(_ANSWERED, FrameRole.DUPLICATE),
    (_ANSWERED, CallEvent.NOTICE): Transition(_ANSWERED, FrameRole.NOTICE),
    (_ANSWERED, CallEvent.REPLY): Transition(_ANSWERED, FrameRole.LATE),
    (_ANSWERED, CallEvent.EARLIER_REPLY): Transition(_ANSWERED, FrameRole.LATE),
    (_ANSWERED, CallEvent.EXPIRY): Transition(CallState.SETTLED, None),
    (_ANSWERED, CallEvent.EVICTION): Transition(CallState.SETTLED, None),
    # The client has moved on and discards what arrives.
    (_ABANDONED, CallEvent.LATER_RETRY): Transition(_ABANDONED, FrameRole.RETRY),
    (_ABANDONED, CallEvent.OVERTAKEN_RETRY): Transition(_ABANDONED, FrameRole.RETRY),
    (_ABANDONED, CallEvent.FIRST_ATTEMPT): Transition(_ABANDONED, FrameRole.REQUEST),
    (_ABANDONED, CallEvent.COPY): Transition(_ABANDONED, FrameRole.DUPLICATE),
    (_ABANDONED, CallEvent.NOTICE): Transition(_ABANDONED, FrameRole.NOTICE),
    (_ABANDONED, CallEvent.REPLY): Transition(_ABANDONED, FrameRole.LATE),
    (_ABANDONED, CallEvent.EARLIER_REPLY): Transition(_ABANDONED, FrameRole.LATE),
    (_ABANDONED, CallEvent.EXPIRY): Transition(CallState.SETTLED, None),
    (_ABANDONED, CallEvent.EVICTION): Transition(CallState.EVICTED, None),
    # The call was returned without a reply; when the client moves on is still recorded.
    (CallState.UNANSWERED, CallEvent.NEXT_CALL): Transition(CallState.SETTLED, None),
}
