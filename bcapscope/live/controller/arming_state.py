"""Arming state: whether bcapscope may send calls that may energise or move a robot, and for how long."""

from __future__ import annotations

DISARM_AFTER = 180_000_000_000
"""Time in ns from the last call that needed arming until arming ends automatically."""


class ArmingState:
    """Whether the user has confirmed that bcapscope may move the robot. Arming ends after `DISARM_AFTER`.

    `is_required` is False if the controller is the built-in simulator.
    """

    def __init__(self) -> None:
        self.is_required = True
        self._armed_until: int | None = None

    def arm(self, now: int) -> None:
        self._armed_until = now + DISARM_AFTER

    def disarm(self) -> None:
        self._armed_until = None

    def extend(self, now: int) -> None:
        """Extend arming, because the user makes calls. Arming that has expired is not extended."""
        if self.is_armed(now):
            self._armed_until = now + DISARM_AFTER

    def is_armed(self, now: int) -> bool:
        return self._armed_until is not None and now < self._armed_until

    def allows_armed_calls(self, now: int) -> bool:
        return not self.is_required or self.is_armed(now)

    def remaining(self, now: int) -> int:
        return max(0, self._armed_until - now) if self._armed_until is not None else 0
