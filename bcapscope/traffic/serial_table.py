"""Serials of one conversation: the call that each one stands for."""

from __future__ import annotations

from bcapscope.traffic.call import Call

MAX_REUSED = 16
"""Limit of unanswered TCP requests remembered per serial, and of serials with such requests."""

MAX_SETTLED_SERIALS = 1024
"""Serials of settled calls: at least this many are remembered, at most twice as many."""


class SerialTable:
    """The serials of open calls, and of those that settled lately.

    Attributes:
        open_calls: Open call by the serial of each of its attempts.
        reused: Requests on TCP by serial that wait for a reply although a later request has the same serial,
            oldest first; a number stands for a call that has settled.
    """

    def __init__(self) -> None:
        self.open_calls: dict[int, Call] = {}
        self.reused: dict[int, list[Call | int]] = {}
        self._settled: dict[int, int] = {}
        self._older_settled: dict[int, int] = {}

    def settled_call(self, serial: int) -> int | None:
        """Return the number of the settled call that had this serial last; None if there is none."""
        return self._settled.get(serial) or self._older_settled.get(serial)

    def release_all(self, call: Call) -> None:
        """Release every serial of a call, including the serial in the reserved field of its retries."""
        reserved = call.request.item.reserved
        for serial in {*call.serials, *((reserved,) if reserved else ())}:
            self.release(serial, call)

    def release(self, serial: int, call: Call) -> None:
        """Release a serial of a call that takes no more frames."""
        if self.open_calls.get(serial) is call:
            del self.open_calls[serial]
        settled = self._settled
        settled[serial] = call.number
        if len(settled) >= MAX_SETTLED_SERIALS:
            self._older_settled, self._settled = settled, {}
        if serial in self.reused:
            queue = self.reused[serial]
            queue[:] = [call.number if waiting is call else waiting for waiting in queue]

    def queue_reused(self, serial: int) -> None:
        """Queue the open request with this serial, since TCP keeps the order and its reply comes first.

        The Python client reuses its serial after a timeout (orin_bcap Python bcapclient.py).
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
        """Return the oldest request in the queue of a serial; drop it from the queue if it is answered."""
        queue = self.reused[serial]
        oldest = queue[0]
        if is_answered:
            del queue[0]
            if not queue:
                del self.reused[serial]
        return oldest
