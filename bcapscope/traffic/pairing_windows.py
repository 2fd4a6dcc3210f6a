"""Limits of `ConversationPairing`: the times within which a call can get further frames, and the memory."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.protocol.tables.hresult import E_BUSY
from bcapscope.traffic.call import Call
from bcapscope.traffic.client_timeout import gives_up_at
from bcapscope.traffic.observation import Conversation, Transport

COPIES_WITHIN_NS = 100_000_000
"""Maximum delay in ns of a frame that the network copied or reordered. A restarted client that reuses its
port can send equal frames again, but begins with Service_Start.
"""

RETRY_WITHIN_NS = 5_000_000_000
"""Maximum time in ns from a reply to a retry. The timeout is 3 s in DENSO's ROS 2 driver, and 1 s in DENSO
Wave 2009.
"""

LATE_WITHIN_NS = 1_000_000_000
"""Maximum time in ns to wait for a reply to an older call, if a newer call was answered."""

BUSY_WITHIN_NS = 30_000_000_000
"""Maximum time in ns to wait for a reply to an abandoned call, if no newer call was answered: the controller
may still be executing the abandoned call.
"""

EXECUTION_NS = 180_000_000_000
"""Maximum time in ns between two frames of an unanswered call, if the controller has answered no newer call.
The value is the InvokeTimeout of DENSO's C server: after this time, the server no longer answers (orin_bcap
C/src/bCAPServer/bcap_server.c).
"""

MAX_EXTRA_FRAMES = 65536
"""Maximum number of retries, notices and further replies in all open calls of a conversation, about 30 MB of
memory. If a frame exceeds the limit, the call of this frame and all older calls are evicted. Calls that began
later remain open. The older C client, which retries without end (start-jsk/denso b-Cap.c), reaches the limit
in 22 minutes at a timeout of 20 ms.
"""

FRAME_COST = 512
"""Overhead of a frame in bytes."""

LARGE_CALL = 64 * 1024
"""If the newest call is complete and exceeds this size in bytes, `ConversationPairing` drops its reference to
the call.
"""


def unanswered_settles_at(call: Call, latest_answered: int, answered_early: Sequence[tuple[int, int]]) -> int:
    """Return the time, in ns since 1970, after which an open call without a reply can get no further frame.

    `latest_answered` is the highest number of an answered call. `answered_early` lists the calls that were
    answered before an older call: pairs of call number and reply time, earliest reply first.
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
    """Set `no_reply_expected` of each open call at the end of the conversation. `open_calls` is oldest first.

    Controllers answer in order, but on UDP, the reply to an older call can come up to `COPIES_WITHIN_NS`
    after the reply to a newer call. If a client has given up a call, it accepts no reply to this call. `now`
    is when the capture ended, ns since 1970; 0 if nothing was captured after the conversation.
    """
    if not open_calls:
        return
    closing = conversation.connection_end
    over = closing is not None and closing.ends_replies
    end = max(call.last_activity for call in open_calls)
    overtaken = end + 1 if conversation.transport is Transport.TCP else end - COPIES_WITHIN_NS
    # `answered` is the time of the earliest reply (except E_BUSY) to a call newer than `call`. If there is no
    # such reply, or if it is later than `overtaken`, `answered` equals `overtaken`.
    answered = overtaken
    for call in reversed(open_calls):
        gives_up = gives_up_at(call)
        call.no_reply_expected = over or answered < overtaken or 0 < gives_up <= now
        if call.reply is not None and call.reply.item.code != E_BUSY:
            answered = min(answered, call.reply.time)
