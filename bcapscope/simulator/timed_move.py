"""An ordinary motion as seen by the calls that wait for it: when the motion is done, hold and resume.

It is assumed that Hold stops the motion at once, and that Unhold starts the rest of the motion from rest. No
source says so.
"""

from __future__ import annotations

from bcapscope.simulator.arm import ENCODER_LAG_NS, Arm
from bcapscope.simulator.kinematics import Joints
from bcapscope.simulator.pose_notation import END_OF_ENCODERS, PASSING

NEVER = 1 << 62
"""Time in ns that no clock reaches."""

PASS_SHARE = 0.7
"""Share of a motion's time after which @P allows the next motion; the figure is assumed."""


class TimedMove:
    """A motion that starts at the commanded joints.

    Attributes:
        done_at: Time in ns from which the next motion may begin; `NEVER` while the motion is held.
    """

    def __init__(
        self, arm: Arm, goal: Joints, now: int, speed: float, *, passing: int = 0, min_duration: int = 0
    ) -> None:
        """Begin the motion; `passing` is as in `MotionTarget`, `min_duration` in ns.

        `speed` is a share of the highest speed, above 0 and at most 1.
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
        """Hold the motion at the commanded joints, unless the motion has ended."""
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
        """End the motion early, at the currently commanded joints."""
        self._arm.halt(now)
        self.done_at = now

    def _start(self, now: int, min_duration: int) -> None:
        ends = self._arm.move(self._goal, now, self._speed, min_duration).ends
        if self._passing == END_OF_ENCODERS:
            ends += ENCODER_LAG_NS
        elif self._passing == PASSING:
            ends = now + round((ends - now) * PASS_SHARE)
        self.done_at = ends
