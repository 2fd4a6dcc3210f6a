"""Armed or not: whether calls that may move a robot go out, and for how long."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.protocol.effects import Effect
from bcapscope.protocol.guard import always_passes, request_effect
from bcapscope.protocol.variant import Variant

LAPSES_AFTER = 180_000_000_000
"""ns after the last call that may have moved something; then nobody is thought to stand by the robot."""


def may_move(function_id: int, arguments: Sequence[Variant]) -> bool:
    """Tell whether a request may set something in motion, so that it needs arming."""
    if always_passes(function_id, arguments):
        return False
    return request_effect(function_id, arguments) >= Effect.MOVES


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
        """Take note of a call that may move something: somebody is there, so the time begins anew."""
        if self.is_armed(now):
            self._until = now + LAPSES_AFTER

    def is_armed(self, now: int) -> bool:
        """Tell whether it is armed."""
        return self._until is not None and now < self._until

    def lets_pass(self, now: int) -> bool:
        """Tell whether what may move something goes out."""
        return not self.needed or self.is_armed(now)

    def left(self, now: int) -> int:
        """Return ns until it lapses; 0 where it is not armed."""
        return max(0, self._until - now) if self._until is not None else 0
