"""Detects that a controller does not reply any more."""

from __future__ import annotations

REPLY_OVERDUE_AFTER = 1_500_000_000
"""Time in ns after which a reply is overdue. Only calls that move the robot take longer than this time."""


class ReplyMonitor:
    """Stores when the controller last sent a packet on any connection, and since when a reply is missing. Any
    thread may report requests and packets. All times are in ns of the same clock.
    """

    def __init__(self, now: int) -> None:
        self._last_received = now
        self._waiting_since = 0

    def on_request(self, now: int) -> None:
        """Start to measure the waiting time for a reply. A retry does not restart the waiting time."""
        self._waiting_since = self._waiting_since or now

    def on_received(self, now: int) -> None:
        self._last_received, self._waiting_since = now, 0

    def silence(self, now: int) -> int:
        return now - self._last_received

    def is_reply_overdue(self, now: int) -> bool:
        asked = self._waiting_since
        return asked > 0 and now - asked > REPLY_OVERDUE_AFTER
