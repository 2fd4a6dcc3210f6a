"""How long a client waits for a reply, inferred from the times between its attempts."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from operator import attrgetter
from statistics import median

from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.unseen_attempts import skipped_serials

SHORTEST_TIMEOUT_NS = 2_000_000
"""Shortest timeout of a client, ns (DENSO Wave 2009, slvMove). If a client begins the next call less than
this time after an unanswered request, the client does not wait for replies. The client may still accept the
reply to this request.
"""

TIMEOUTS_TO_GIVE_UP = 4
"""A client evidently gave up a retried call if no attempt follows within this many timeouts."""

SHORTEST_SILENCE_NS = 50_000_000
"""Minimum silence in ns that shows that a client gave up. A busy client delays attempts by less than this."""

OVERDUE_TIMEOUTS = 2
"""A reply is late if the time since the last attempt exceeds this multiple of the estimated timeout."""

_MAX_DISTANCES = 32
_MAX_KINDS = 64


def attempt_distances(call: Call) -> list[int]:
    """Return the times in ns between successive attempts. Uncaptured attempts count as evenly spaced."""
    attempts = call.attempts
    if not call.unseen_serials:
        times = sorted(each.time for each in attempts)
        return [after - before for before, after in pairwise(times)]
    return [
        (after.time - before.time) // (1 + len(skipped_serials(before.item.serial, after.item.serial)))
        for before, after in pairwise(sorted(attempts, key=attrgetter("time")))
    ]


def waits_since(call: Call) -> int:
    """Return the time of the last attempt, or of the latest S_EXECUTING for this attempt, ns since 1970."""
    serial, sent_at = call.last_attempt.item.serial, call.last_attempt.time
    return max((sent_at, *(notice.time for notice in call.notices if notice.item.serial == serial)))


def gives_up_at(call: Call) -> int:
    """Return when the client evidently gave up an unanswered call, ns since 1970. Return 0 for a call without
    retries, and for a call with S_EXECUTING, because S_EXECUTING prolongs the timeout (DENSO Wave 2009).
    """
    silence = _silence_of(call, TIMEOUTS_TO_GIVE_UP)
    return call.last_attempt.time + silence if silence else 0


def waits_in_vain(call: Call, now: int) -> bool:
    """Return whether an unanswered call has lasted at least `TIMEOUTS_TO_GIVE_UP - 1` times the client's
    timeout, and at least `SHORTEST_SILENCE_NS`. Return False if the client's timeout is unknown.
    """
    silence = _silence_of(call, TIMEOUTS_TO_GIVE_UP - 1)
    return bool(silence) and now - call.request.time >= silence


def _silence_of(call: Call, timeouts: int) -> int:
    """Multiply the client's timeout by the number `timeouts`. Return the product in ns, but at least
    `SHORTEST_SILENCE_NS`. Return 0 if the client's timeout is unknown.
    """
    distances = attempt_distances(call) if call.other_frames and not call.notices else ()
    return max(timeouts * round(median(distances)), SHORTEST_SILENCE_NS) if distances else 0


class ShownTimeouts:
    """The timeouts that one client uses for each kind of call, inferred from its attempts."""

    def __init__(self) -> None:
        self._distances: BoundedDict[CallKind, deque[int]] = BoundedDict(_MAX_KINDS)

    def add_call(self, call: Call) -> int:
        """Learn the client's timeout from a complete call. If the reply was late (see `OVERDUE_TIMEOUTS`),
        return the time when the client stopped waiting, ns since 1970. Otherwise, return 0.
        """
        distances = attempt_distances(call)
        if not distances:
            return 0
        usual = self._distances.get(call.kind, deque(maxlen=_MAX_DISTANCES))
        usual.extend(distances)
        self._distances[call.kind] = usual
        reply, sent_at = call.reply, call.last_attempt.time
        if reply is None:
            return 0
        if any(notice.time <= reply.time for notice in call.notices):  # the client waited longer
            return 0
        timeout = max(*distances, round(median(usual)), SHORTEST_TIMEOUT_NS)
        return sent_at + timeout if reply.time - sent_at > OVERDUE_TIMEOUTS * timeout else 0
