"""Armed or not: whether calls that may energise or move a robot go out, and for how long."""

from __future__ import annotations

DISARM_AFTER = 180_000_000_000
"""ns after the last call that needed arming; after that, nobody is assumed to watch the robot."""


class ArmingState:
    """Armed by a person, disarmed by one or by the time; our own simulator needs none.

    Attributes:
        is_required: whether the peer is anything but our simulator.
    """

    def __init__(self) -> None:
        """Begin disarmed."""
        self.is_required = True
        self._armed_until: int | None = None

    def arm(self, now: int) -> None:
        """Arm."""
        self._armed_until = now + DISARM_AFTER

    def disarm(self) -> None:
        """Disarm at once."""
        self._armed_until = None

    def extend(self, now: int) -> None:
        """Restart the time on a call that needs arming, since somebody is watching the robot."""
        if self.is_armed(now):
            self._armed_until = now + DISARM_AFTER

    def is_armed(self, now: int) -> bool:
        """Tell whether it is armed."""
        return self._armed_until is not None and now < self._armed_until

    def allows_armed_calls(self, now: int) -> bool:
        """Return whether calls that need arming go out."""
        return not self.is_required or self.is_armed(now)

    def remaining(self, now: int) -> int:
        """Return ns until it lapses; 0 where it is not armed."""
        return max(0, self._armed_until - now) if self._armed_until is not None else 0
