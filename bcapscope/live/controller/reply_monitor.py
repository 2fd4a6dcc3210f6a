"""Detects a silent controller from its traffic."""

from __future__ import annotations

REPLY_OVERDUE_AFTER = 1_500_000_000
"""ns after which a reply is overdue: longer than any call takes except a motion."""


class ReplyMonitor:
    """When the controller last sent something, on any connection, and whether a reply is due.

    Requests and received packets update it, in any thread. Times are ns of one clock. Silence counts only
    from a request on: without a request, nothing is expected.
    """

    def __init__(self, now: int) -> None:
        self._last_received = now
        self._waiting_since = 0

    def on_request(self, now: int) -> None:
        """Note a request; a retry does not restart the waiting time."""
        self._waiting_since = self._waiting_since or now

    def on_received(self, now: int) -> None:
        self._last_received, self._waiting_since = now, 0

    def silence(self, now: int) -> int:
        """Return ns since the last packet received."""
        return now - self._last_received

    def is_reply_overdue(self, now: int) -> bool:
        """Return whether a reply has been due for longer than `REPLY_OVERDUE_AFTER`."""
        asked = self._waiting_since
        return asked > 0 and now - asked > REPLY_OVERDUE_AFTER
