"""Detects from requests and replies that a controller has fallen silent."""

from __future__ import annotations

REPLY_OVERDUE_AFTER = 1_500_000_000
"""Time in ns after a request at which its reply is overdue. No call except a motion takes so long."""


class ReplyMonitor:
    """Stores when the controller last sent something on any connection, and since when bcapscope has been
    waiting for a reply.

    Any thread may report requests and received packets. All times are in ns of the same clock. Without a
    request, no reply is expected.
    """

    def __init__(self, now: int) -> None:
        self._last_received = now
        self._waiting_since = 0

    def on_request(self, now: int) -> None:
        """Store when a request was sent. A retry does not restart the waiting time."""
        self._waiting_since = self._waiting_since or now

    def on_received(self, now: int) -> None:
        self._last_received, self._waiting_since = now, 0

    def silence(self, now: int) -> int:
        """Return the time in ns since the last packet was received."""
        return now - self._last_received

    def is_reply_overdue(self, now: int) -> bool:
        """Return whether bcapscope has waited for a reply for longer than `REPLY_OVERDUE_AFTER`."""
        asked = self._waiting_since
        return asked > 0 and now - asked > REPLY_OVERDUE_AFTER
