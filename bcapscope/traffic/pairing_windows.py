"""How long a further frame of a call can follow: the time windows of `ConversationPairing`."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.traffic.call import Call
from bcapscope.traffic.client_timeout import gives_up_at
from bcapscope.traffic.observation import Transport

COPIES_WITHIN_NS = 100_000_000
"""Maximum time in ns within which copies and reordered frames arrive: factory networks delay a frame by
milliseconds. No client restarts on the same port this fast without a Service_Start."""

RETRY_WITHIN_NS = 5_000_000_000
"""Maximum time in ns from a captured reply to a retry of its request. No client waits longer before a retry
(3 s in DENSO's ROS 2 driver, 1 s in DENSO Wave 2009)."""

LATE_WITHIN_NS = 1_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call, if the controller has answered
a later call. A reply after this time is a stray reply that names its call."""

BUSY_WITHIN_NS = 30_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call, if the controller has not
answered a later call. The controller may still be executing the call, because controllers answer in order."""

EXECUTION_NS = 180_000_000_000
"""Maximum time in ns without a frame of a call, if no later call was answered: the server's InvokeTimeout,
after which the server never answers (orin_bcap C/src/bCAPServer/bcap_server.c)."""


def settles_at(
    call: Call, is_newest: bool, latest_answered: int, answered_early: Sequence[tuple[int, int]]
) -> int:
    """Return the time from which on no further frame can belong to an open call, ns since 1970.

    Args:
        is_newest: Whether the client has not begun another call since.
        latest_answered: Highest number of an answered call of the conversation.
        answered_early: Number and time of the calls that were answered before an older call, oldest first.
    """
    quiet = call.last_activity
    if call.reply is not None:
        if call.conversation.transport is Transport.TCP:
            return quiet
        return quiet + (RETRY_WITHIN_NS if is_newest else COPIES_WITHIN_NS)
    if call.abandoned_at:
        since = max(quiet, call.abandoned_at)
        if call.number >= latest_answered:
            return since + BUSY_WITHIN_NS
        return max(since + LATE_WITHIN_NS, answered_early[0][1] + COPIES_WITHIN_NS)
    if call.number < latest_answered:
        return quiet + LATE_WITHIN_NS
    gives_up = gives_up_at(call)
    return max(gives_up, quiet + RETRY_WITHIN_NS) if gives_up else quiet + EXECUTION_NS
