"""Time windows and memory limits of `ConversationPairing`. A window is the time in which a call can get
further frames.
"""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.protocol.tables.hresult import E_BUSY
from bcapscope.traffic.call import Call
from bcapscope.traffic.client_timeout import gives_up_at
from bcapscope.traffic.observation import Conversation, Transport

COPIES_WITHIN_NS = 100_000_000
"""Maximum delay in ns of copies and reordered frames. Factory networks delay a frame by milliseconds. Within
this time, no client restarts on the same port without a Service_Start.
"""

RETRY_WITHIN_NS = 5_000_000_000
"""Maximum time in ns from a captured reply to a retry of its request. No client waits longer before a retry
(3 s in DENSO's ROS 2 driver, 1 s in DENSO Wave 2009)."""

LATE_WITHIN_NS = 1_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call. This limit is valid if the
controller has answered a later call. A reply after this time is a stray reply, which names the call that it
answers.
"""

BUSY_WITHIN_NS = 30_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call. This limit is valid if the
controller has not answered a later call. The controller may still be executing the call, because controllers
answer in order.
"""

EXECUTION_NS = 180_000_000_000
"""Maximum time in ns between two frames of a call, if the controller has answered no later call. The value is
the InvokeTimeout of DENSO's C server, after which this server no longer answers (orin_bcap
C/src/bCAPServer/bcap_server.c).
"""

MAX_EXTRA_FRAMES = 65536
"""Maximum number of retries, notices and further replies in all open calls of a conversation together. These
frames take about 30 MB of memory. If a call exceeds the limit, this call and all earlier calls are evicted.
Further frames of the evicted call start another call. The older C client retries without end (start-jsk/denso
b-Cap.c). A client that retries every 20 ms without end reaches the limit within 22 minutes.
"""

FRAME_COST = 512
"""Overhead of a frame in bytes."""

LARGE_CALL = 64 * 1024
"""Maximum size in bytes of a settled call that `ConversationPairing` keeps as the newest call."""


def unanswered_settles_at(call: Call, latest_answered: int, answered_early: Sequence[tuple[int, int]]) -> int:
    """Return the time, in ns since 1970, after which an open call without a reply can get no further frame.

    Args:
        latest_answered: Highest number of an answered call of the conversation.
        answered_early: Call number and reply time of each call that was answered before an older call, oldest
            first.
    """
    quiet = call.last_activity
    if call.abandoned_at:
        since = max(quiet, call.abandoned_at)
        if call.number >= latest_answered:
            return since + BUSY_WITHIN_NS
        return max(since + LATE_WITHIN_NS, answered_early[0][1] + COPIES_WITHIN_NS)
    if call.number < latest_answered:
        return quiet + LATE_WITHIN_NS
    gives_up = gives_up_at(call)
    return max(gives_up, quiet + RETRY_WITHIN_NS) if gives_up else quiet + EXECUTION_NS


def mark_unanswerable(conversation: Conversation, open_calls: Sequence[Call], now: int) -> None:
    """Mark the open calls that could no longer be answered when the traffic of their conversation ended.

    If a later call has a reply, an open call can no longer be answered, because controllers answer in order.
    The network reorders replies only within a short time. A call can also no longer be answered if the client
    gave it up before the capture ended, as the times between its attempts show.

    `open_calls` lists the oldest call first. `now` is the time when the capture ends, ns since 1970; 0 if the
    capture ends with the conversation.
    """
    closing = conversation.connection_end
    over = closing is not None and closing.ends_replies
    end = max((call.last_activity for call in open_calls), default=0)
    overtaken = end + 1 if conversation.transport is Transport.TCP else end - COPIES_WITHIN_NS
    # time of the earliest reply to a later call; `overtaken` if no later call has a reply
    answered = overtaken
    for call in reversed(open_calls):
        gives_up = gives_up_at(call)
        call.no_reply_expected = over or answered < overtaken or 0 < gives_up <= now
        if call.reply is not None and call.reply.item.code != E_BUSY:
            answered = min(answered, call.reply.time)
