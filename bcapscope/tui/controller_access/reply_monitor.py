"""Whether the controller is still there, as far as what comes from it tells."""

from __future__ import annotations

REPLY_OVERDUE_AFTER = 1_500_000_000
"""Nanoseconds for which an answer may be owed: longer than any other call than a motion takes."""


class ReplyMonitor:
    """When the controller was heard last, on any of the lines to it, and whether it owes an answer.

    What is sent and received tells, in any thread; times are ns of one clock. Where nothing is asked, nothing
    is known: a silence counts only from a request on.
    """

    def __init__(self, now: int) -> None:
        """Begin with a controller that was asked nothing yet."""
        self._last_received = now
        self._waiting_since = 0

    def on_request(self, now: int) -> None:
        """Take notice of a request; what is asked once more is owed since the first time."""
        self._waiting_since = self._waiting_since or now

    def on_received(self, now: int) -> None:
        """Take notice of anything that came."""
        self._last_received, self._waiting_since = now, 0

    def silence(self, now: int) -> int:
        """Return for how long nothing has come."""
        return now - self._last_received

    def is_reply_overdue(self, now: int) -> bool:
        """Tell whether an answer is owed for longer than it should take."""
        asked = self._waiting_since
        return asked > 0 and now - asked > REPLY_OVERDUE_AFTER
