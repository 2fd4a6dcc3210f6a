"""The arm over time: ordinary motions, set points, and encoders that lag behind the commanded joints.

Times are in ns, joints in degrees. An ordinary motion follows the minimum-jerk curve.
"""

from __future__ import annotations

from collections import deque
from math import sqrt
from typing import NamedTuple, TypeAlias

from bcapscope.simulator.kinematics import AXIS_LIMITS, Joints
from bcapscope.simulator.pose_notation import END_OF_ENCODERS, PASSING

MS = 1_000_000
ENCODER_LAG_NS = 24 * MS

NEVER = 1 << 62
"""Time in ns that means never: no clock reaches it."""

PASS_SHARE = 0.7
"""With @P, the next motion may begin after this share of a motion's duration."""

# highest speed and acceleration of a minimum-jerk curve that covers distance 1 in time 1
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 5.774

_Step: TypeAlias = tuple[int, Joints]


class ArmMotion(NamedTuple):
    """An ordinary motion of the commanded joints; the encoders follow `ENCODER_LAG_NS` later."""

    start: Joints
    goal: Joints
    began: int
    ends: int

    def at(self, time: int) -> Joints:
        if time >= self.ends:
            return self.goal
        if time <= self.began:
            return self.start
        part = (time - self.began) / (self.ends - self.began)
        share = part**3 * (10 - 15 * part + 6 * part**2)
        return tuple(a + (b - a) * share for a, b in zip(self.start, self.goal, strict=True))


def motion_duration(start: Joints, goal: Joints, speed: float) -> int:
    """Return the shortest duration in ns that all axes allow. `speed` is a share of the speed limits."""
    longest = 0.0
    for a, b, limit in zip(start, goal, AXIS_LIMITS, strict=False):
        way = abs(b - a)
        at_speed = _PEAK_SPEED * way / (limit.speed * speed)
        longest = max(longest, at_speed, sqrt(_PEAK_ACCELERATION * way / limit.acceleration))
    return round(longest * 1e9)


class Arm:
    def __init__(self, joints: Joints) -> None:
        self._motion = ArmMotion(joints, joints, 0, 0)
        self._steps: deque[_Step] = deque(maxlen=8)
        self._changed = -ENCODER_LAG_NS

    @property
    def goal(self) -> Joints:
        """Joints at the end of the current motion, or the current joints if the arm is at rest."""
        return self._steps[-1][1] if self._steps else self._motion.goal

    @property
    def ends(self) -> int:
        """Time in ns at which the commanded joints reach the goal of the last ordinary motion."""
        return self._motion.ends

    @property
    def at_rest_from(self) -> int:
        """Time in ns at which the encoders come to rest if no new motion begins."""
        return (self._changed if self._steps else max(self._changed, self._motion.ends)) + ENCODER_LAG_NS

    def is_at_rest(self, now: int) -> bool:
        return now >= self.at_rest_from

    def commanded(self, now: int) -> Joints:
        if not self._steps:
            return self._motion.at(now)
        before = self._steps[0]
        for step in self._steps:
            if step[0] > now:
                return _interpolate(before, step, now)
            before = step
        return before[1]

    def actual(self, now: int) -> Joints:
        return self.commanded(now - ENCODER_LAG_NS)

    def move(self, goal: Joints, now: int, speed: float, min_duration: int) -> None:
        start = self.commanded(now)
        duration = max(min_duration, motion_duration(start, goal, speed))
        self._motion = ArmMotion(start, goal, now, now + duration)
        self._steps.clear()

    def halt(self, now: int) -> None:
        here = self.commanded(now)
        self._motion = ArmMotion(here, here, now, now)
        self._steps.clear()
        self._changed = now

    def add_set_point(self, joints: Joints, began: int, time: int) -> None:
        """Stand still until `began`, then move in a straight line to `joints`, until `time`."""
        if not self._steps or joints != self._steps[-1][1]:
            self._changed = time
        if self._steps and self._steps[-1][0] < began:
            self._steps.append((began, self._steps[-1][1]))
        self._steps.append((time, joints))

    def begin_set_points(self, now: int) -> None:
        here = self.goal
        self._steps.clear()
        self._steps.append((now, here))


def _interpolate(before: _Step, after: _Step, time: int) -> Joints:
    span = after[0] - before[0]
    share = (time - before[0]) / span if span else 1.0
    if not 0.0 <= share <= 1.0:
        share = 0.0 if share < 0.0 else 1.0
    # No loop, for speed: every slvMove calls this function, and a loop makes slvMove a tenth slower.
    a1, a2, a3, a4, a5, a6, _, _ = before[1]
    b1, b2, b3, b4, b5, b6, _, _ = after[1]
    return (
        a1 + (b1 - a1) * share,
        a2 + (b2 - a2) * share,
        a3 + (b3 - a3) * share,
        a4 + (b4 - a4) * share,
        a5 + (b5 - a5) * share,
        a6 + (b6 - a6) * share,
        0.0,
        0.0,
    )


class TimedMove:
    """An ordinary motion that a client can hold and resume. The next motion may begin at `done_at`, in ns."""

    def __init__(
        self, arm: Arm, goal: Joints, now: int, speed: float, *, passing: int = 0, min_duration: int = 0
    ) -> None:
        """Begin the motion; `speed` is a share of the highest speed. `MotionTarget` describes `passing`."""
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
        """Stop the motion until `resume`. If the motion has ended, do nothing."""
        left = self._arm.ends - now
        if left > 0 and not self.is_held:
            self._arm.halt(now)
            self._remaining = left
            self.done_at = NEVER

    def resume(self, now: int) -> None:
        if self.is_held:
            self._start(now, self._remaining)

    def skip(self, now: int) -> None:
        """End the motion early, at the currently commanded joints."""
        self._arm.halt(now)
        self.done_at = now

    def _start(self, now: int, min_duration: int) -> None:
        self._arm.move(self._goal, now, self._speed, min_duration)
        ends = self._arm.ends
        if self._passing == END_OF_ENCODERS:
            ends += ENCODER_LAG_NS
        elif self._passing == PASSING:
            ends = now + round((ends - now) * PASS_SHARE)
        self.done_at = ends
