"""Armed or not: whether calls that may energise or move a robot go out, and for how long."""

from __future__ import annotations

LAPSES_AFTER = 180_000_000_000
"""ns after the last call that needed arming; after that, nobody is assumed to watch the robot."""


class Arming:
    """Armed by a person, disarmed by one or by the time; our own simulator needs none.

    Attributes:
        needed: whether the peer is anything but our simulator.
    """

    def __init__(self) -> None:
        """Begin disarmed."""
        self.needed = True
        self._until: int | None = None

    def arm(self, now: int) -> None:
        """Arm."""
        self._until = now + LAPSES_AFTER

    def disarm(self) -> None:
        """Disarm at once."""
        self._until = None

    def used(self, now: int) -> None:
        """Restart the time on a call that needs arming, since somebody is watching the robot."""
        if self.is_armed(now):
            self._until = now + LAPSES_AFTER

    def is_armed(self, now: int) -> bool:
        """Tell whether it is armed."""
        return self._until is not None and now < self._until

    def lets_pass(self, now: int) -> bool:
        """Return whether calls that need arming go out."""
        return not self.needed or self.is_armed(now)

    def left(self, now: int) -> int:
        """Return ns until it lapses; 0 where it is not armed."""
        return max(0, self._until - now) if self._until is not None else 0
