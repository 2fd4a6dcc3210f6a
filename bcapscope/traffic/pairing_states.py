"""Table of the states of a call, and of the events that change its state while its frames are captured.

`TRANSITIONS` maps each pair of state and event to the next state and the role of the added frame.
`ConversationPairing` determines from serials, bytes and times which event a frame causes. A pair of state and
event that is missing from the table cannot occur.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from bcapscope.traffic.call import CallState, FrameRole

CAPTURED_AGAIN_WITHIN_NS = 1_000_000
"""Maximum time in ns between two records of one packet, such as from two interfaces or a mirror port. An
exact copy within this time is probably the same packet, because a retry has a new serial.
"""


class CallEvent(StrEnum):
    """Event that can change the state of a call."""

    RETRY = "retry"
    """The client sends another attempt of its newest call."""
    LATER_RETRY = "later retry"
    """The client retries the call, although the client has already begun a newer call."""
    OVERTAKEN_RETRY = "overtaken retry"
    """A retry arrives later than a newer attempt, which overtook the retry on the network."""
    FIRST_ATTEMPT = "first attempt"
    """The first attempt arrives later than a retry, which overtook the first attempt on the network."""
    COPY = "copy"
    """An exact copy of an earlier frame of the call arrives."""
    CAPTURED_AGAIN = "captured again"
    """The capture holds the same packet twice, and this packet contains a frame of the call."""
    NOTICE = "notice"
    """The controller sends S_EXECUTING."""
    REPLY = "reply"
    """The controller answers the latest attempt."""
    EARLIER_REPLY = "earlier reply"
    """The controller answers an attempt that is not the latest one."""
    OVERDUE_REPLY = "overdue reply"
    """The reply to the latest attempt came after the client had given up. bcapscope detects an overdue reply
    when the call becomes complete. The times between the attempts show the client's timeout.
    """
    UNDELIVERED_REPLY = "undelivered reply"
    """The controller sends a reply that is lost before it reaches the client's side."""
    NEXT_CALL = "next call"
    """The client begins another call, after it waited for a reply for at least the shortest timeout."""
    EXPIRY = "expiry"
    """No further frame can belong to the call, or the traffic has ended."""
    EVICTION = "eviction"
    """The call is evicted from memory, although a reply may follow."""


class Transition(NamedTuple):
    """The effect of an event on a call.

    Attributes:
        role: Role of the frame that the event adds to the call; None if the event adds no frame.
        reply_becomes: New role of the reply that the call already has; None if this reply keeps its role.
    """

    state: CallState
    role: FrameRole | None
    reply_becomes: FrameRole | None = None


_WAITING, _EXECUTING = CallState.WAITING, CallState.EXECUTING
_ANSWERED, _ABANDONED = CallState.ANSWERED, CallState.ABANDONED

_ROLES_WITHOUT_CHANGE = {
    CallEvent.LATER_RETRY: FrameRole.RETRY,
    CallEvent.OVERTAKEN_RETRY: FrameRole.RETRY,
    CallEvent.FIRST_ATTEMPT: FrameRole.REQUEST,
    CallEvent.COPY: FrameRole.DUPLICATE,
    CallEvent.CAPTURED_AGAIN: FrameRole.CAPTURED_AGAIN,
    CallEvent.EARLIER_REPLY: FrameRole.LATE,
    CallEvent.UNDELIVERED_REPLY: FrameRole.LOST,
}
"""Events that do not change the state of an open call. Each of these events adds a frame to the call, and
`_ROLES_WITHOUT_CHANGE` gives the role of this frame.
"""

TRANSITIONS: dict[tuple[CallState, CallEvent], Transition] = {
    (state, event): Transition(state, role)
    for state in (_WAITING, _EXECUTING, _ANSWERED, _ABANDONED)
    for event, role in _ROLES_WITHOUT_CHANGE.items()
} | {
    # The client waits.
    (_WAITING, CallEvent.RETRY): Transition(_WAITING, FrameRole.RETRY),
    (_WAITING, CallEvent.NOTICE): Transition(_EXECUTING, FrameRole.NOTICE),
    (_WAITING, CallEvent.REPLY): Transition(_ANSWERED, FrameRole.REPLY),
    (_WAITING, CallEvent.NEXT_CALL): Transition(_ABANDONED, None),
    (_WAITING, CallEvent.EXPIRY): Transition(CallState.UNANSWERED, None),
    (_WAITING, CallEvent.EVICTION): Transition(CallState.EVICTED, None),
    # The client waits for the reply, and the controller has sent S_EXECUTING.
    (_EXECUTING, CallEvent.RETRY): Transition(_EXECUTING, FrameRole.RETRY),
    (_EXECUTING, CallEvent.NOTICE): Transition(_EXECUTING, FrameRole.NOTICE),
    (_EXECUTING, CallEvent.REPLY): Transition(_ANSWERED, FrameRole.REPLY),
    (_EXECUTING, CallEvent.NEXT_CALL): Transition(_ABANDONED, None),
    (_EXECUTING, CallEvent.EXPIRY): Transition(CallState.UNANSWERED, None),
    (_EXECUTING, CallEvent.EVICTION): Transition(CallState.EVICTED, None),
    # If the client retries its newest call, it did not receive the reply.
    (_ANSWERED, CallEvent.RETRY): Transition(_WAITING, FrameRole.RETRY, reply_becomes=FrameRole.LOST),
    (_ANSWERED, CallEvent.NOTICE): Transition(_ANSWERED, FrameRole.NOTICE),
    (_ANSWERED, CallEvent.REPLY): Transition(_ANSWERED, FrameRole.LATE),
    (_ANSWERED, CallEvent.OVERDUE_REPLY): Transition(CallState.SETTLED, None, FrameRole.LATE),
    (_ANSWERED, CallEvent.EXPIRY): Transition(CallState.SETTLED, None),
    (_ANSWERED, CallEvent.EVICTION): Transition(CallState.SETTLED, None),
    # The client has begun a newer call, and discards all replies to the abandoned call.
    (_ABANDONED, CallEvent.NOTICE): Transition(_ABANDONED, FrameRole.NOTICE),
    (_ABANDONED, CallEvent.REPLY): Transition(_ABANDONED, FrameRole.LATE),
    (_ABANDONED, CallEvent.EXPIRY): Transition(CallState.SETTLED, None),
    (_ABANDONED, CallEvent.EVICTION): Transition(CallState.EVICTED, None),
    # The tracker has returned the call as unanswered, but still notes when the client begins another call.
    (CallState.UNANSWERED, CallEvent.NEXT_CALL): Transition(CallState.SETTLED, None),
}

AWAITING_REPLY = frozenset(state for state, event in TRANSITIONS if event is CallEvent.NEXT_CALL)
"""States in which the client of the call still waits for a reply."""


def copy_event(time: int, earlier: int) -> CallEvent:
    """Return whether an exact copy of a frame causes the event `CAPTURED_AGAIN` or the event `COPY`. The call
    already has the original frame, which was captured at the time `earlier`. The copy was captured at the
    time `time`. Both times are in ns since 1970.
    """
    return CallEvent.CAPTURED_AGAIN if time - earlier <= CAPTURED_AGAIN_WITHIN_NS else CallEvent.COPY
