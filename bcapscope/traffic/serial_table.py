"""Table that maps the serials of one conversation to calls."""

from __future__ import annotations

from bcapscope.traffic.call import Call
from bcapscope.traffic.recent_serials import RecentSerials
from bcapscope.traffic.unseen_attempts import skipped_serials

MAX_REUSED = 16
"""Maximum number of reused serials, and of TCP calls that wait for a reply with the same serial."""


class SerialTable:
    """The serials of open calls, and of recently completed calls.

    Attributes:
        reused: For each reused serial of a TCP client, a queue of the earlier calls that still wait for a
            reply, oldest first. When a call in the queue becomes complete, its `Call.number` replaces it.
    """

    def __init__(self) -> None:
        self.open_calls: dict[int, Call] = {}
        self.reused: dict[int, list[Call | int]] = {}
        self._settled: RecentSerials[int] = RecentSerials()

    def settled_call(self, serial: int) -> int | None:
        """Return `Call.number` of the latest complete call with this serial."""
        return self._settled.get(serial)

    def add_skipped(self, before: int, after: int, call: Call) -> None:
        """Record that `call` has uncaptured attempts with the serials between `before` and `after`."""
        serials = skipped_serials(before, after)
        call.unseen_serials += serials
        for serial in serials:
            self.open_calls[serial] = call

    def release_all(self, call: Call) -> None:
        """Remove all serials of a call, including the serial in the reserved field of its request."""
        reserved = call.request.item.reserved
        for serial in {*call.serials, *call.unseen_serials, *((reserved,) if reserved else ())}:
            self.release(serial, call)

    def release(self, serial: int, call: Call) -> None:
        if self.open_calls.get(serial) is call:
            del self.open_calls[serial]
        self._settled.put(serial, call.number)
        if serial in self.reused:
            queue = self.reused[serial]
            queue[:] = [call.number if waiting is call else waiting for waiting in queue]

    def queue_reused(self, serial: int) -> None:
        """Append the open call with this serial to the queue in `reused`, because a new request reuses the
        serial. TCP keeps the order of the frames, so the reply to the queued call comes before the reply to
        the new request. The Python client reuses its serial after a timeout (orin_bcap Python bcapclient.py).
        """
        prior = self.open_calls.get(serial)
        if prior is None or prior.reply is not None or prior.late_replies:
            return
        queue = self.reused.setdefault(serial, [])
        queue.append(prior)
        del queue[:-MAX_REUSED]
        if len(self.reused) > MAX_REUSED:
            del self.reused[next(iter(self.reused))]

    def oldest_reused(self, serial: int, is_answered: bool) -> Call | int:
        """Return the oldest call in the queue of a reused serial. If this call is complete, return its
        `Call.number` instead of the `Call`.

        If `is_answered`, remove the call from the queue.
        """
        queue = self.reused[serial]
        oldest = queue[0]
        if is_answered:
            del queue[0]
            if not queue:
                del self.reused[serial]
        return oldest
