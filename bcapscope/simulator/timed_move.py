"""An ordinary motion for the calls that wait for it: when it is done, and holding it.

It is assumed that Hold stops at once, and that the rest of the motion starts again from rest. No source says
so.
"""

from __future__ import annotations

from bcapscope.simulator.arm import ENCODER_LAG_NS, Arm
from bcapscope.simulator.kinematics import Joints
from bcapscope.simulator.pose_notation import END_OF_ENCODERS, PASSING

NEVER = 1 << 62
"""ns; later than any clock gets."""

PASS_SHARE = 0.7
"""Share of a motion's time after which @P allows the next motion; our own."""


class TimedMove:
    """A motion that starts at the commanded joints.

    Attributes:
        done_at: Time from which the next motion may begin, ns; `NEVER` while the motion is held.
    """

    def __init__(
        self, arm: Arm, goal: Joints, now: int, speed: float, *, passing: int = 0, min_duration: int = 0
    ) -> None:
        """Begin the motion; `passing` is as in `MotionTarget`, `min_duration` in ns.

        `speed` is the share of the highest speed, above 0 up to 1.
        """
        self._arm = arm
        self._goal = goal
        self._speed = speed
        self._passing = passing
        self._remaining = 0
        self.done_at = 0
        self._start(now, min_duration)

    @property
    def is_held(self) -> bool:
        return self.done_at == NEVER

    def hold(self, now: int) -> None:
        """Stop at the commanded joints, unless the motion has ended."""
        left = self._arm.ends - now
        if left > 0 and not self.is_held:
            self._arm.halt(now)
            self._remaining = left
            self.done_at = NEVER

    def resume(self, now: int) -> None:
        """Continue a held motion."""
        if self.is_held:
            self._start(now, self._remaining)

    def skip(self, now: int) -> None:
        """End the motion at the commanded joints."""
        self._arm.halt(now)
        self.done_at = now

    def _start(self, now: int, min_duration: int) -> None:
        ends = self._arm.move(self._goal, now, self._speed, min_duration).ends
        if self._passing == END_OF_ENCODERS:
            ends += ENCODER_LAG_NS
        elif self._passing == PASSING:
            ends = now + round((ends - now) * PASS_SHARE)
        self.done_at = ends
