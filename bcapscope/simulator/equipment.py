"""The controller's equipment besides the arm: hands, areas, serial and socket lines.

Times are in ns, widths in mm, and speeds in mm/s.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from bcapscope.simulator.call_outcome import RefusalCode

MAX_AREAS = 32
MAX_LINES = 256


SECOND = 1_000_000_000


class HandLimits(NamedTuple):
    """Limits of a hand: widths in mm, top speed in mm/s, acceleration in mm/s², forces in N.

    `grip_speed` is for HandMoveH, which has no parameter for speed. `slowest` is the lowest speed in percent.
    """

    narrowest: float
    widest: float
    speed: float
    acceleration: float
    grip_speed: float
    slowest: float
    weakest: float
    strongest: float


COBOTTA_HAND = HandLimits(0.0, 30.0, 80.0, 800.0, 20.0, 1.0, 6.0, 20.0)
TWO_FINGER_HAND = HandLimits(1.0, 39.0, 100.0, 1000.0, 20.0, 10.0, 20.0, 140.0)


class HandMotion(NamedTuple):
    """A motion of the fingers that accelerates, keeps its highest speed `speed`, and brakes."""

    start: float
    goal: float
    began: int
    speed: float
    acceleration: float

    @classmethod
    def plan(cls, start: float, goal: float, began: int, speed: float, acceleration: float) -> HandMotion:
        """Plan a motion; a short motion does not reach `speed`."""
        return cls(start, goal, began, min(speed, sqrt(abs(goal - start) * acceleration)), acceleration)

    @property
    def ends(self) -> int:
        return self.time_at_distance(abs(self.goal - self.start))

    def at(self, time: int) -> float:
        if time >= self.ends:
            return self.goal
        way = self._distance_after(max(0, time - self.began) / SECOND)
        return self.start + (way if self.goal > self.start else -way)

    def time_at_distance(self, distance: float) -> int:
        if not distance:
            return self.began
        ramp = self.speed**2 / 2 / self.acceleration
        whole = abs(self.goal - self.start)
        if distance <= ramp:
            seconds = sqrt(2 * distance / self.acceleration)
        elif distance <= whole - ramp:
            seconds = self.speed / 2 / self.acceleration + distance / self.speed
        else:
            left = max(0.0, whole - distance)
            seconds = self.speed / self.acceleration + whole / self.speed - sqrt(2 * left / self.acceleration)
        return self.began + round(seconds * SECOND)

    def _distance_after(self, seconds: float) -> float:
        whole = abs(self.goal - self.start)
        ramp = self.speed / self.acceleration
        total = ramp + whole / self.speed
        if seconds <= ramp:
            return self.acceleration * seconds**2 / 2
        if seconds <= total - ramp:
            return self.speed * (seconds - ramp / 2)
        return whole - self.acceleration * (total - seconds) ** 2 / 2


class Hand:
    """The two fingers of a hand, and possibly an object between the open fingers.

    Attributes:
        motion_count: Number of motions and stops so far.
        stopped_by: Result code that the latest stop gave to the stopped call; 0 before any stop.
        ends: Time in ns at which the last motion ended or will end.
    """

    def __init__(self, limits: HandLimits, object_width: float | None = None) -> None:
        self.limits = limits
        self.object_width = object_width
        self.motion_count = 0
        self.stopped_by = 0
        self._motion = HandMotion.plan(limits.widest, limits.widest, 0, limits.speed, limits.acceleration)
        self.ends = 0
        self._final_width = limits.widest
        self._force = 0.0
        self._touches_object = False

    def width(self, now: int) -> float:
        return self._final_width if now >= self.ends else self._motion.at(now)

    def is_moving(self, now: int) -> bool:
        return now < self.ends

    def is_gripping(self, now: int) -> bool:
        return self._force > 0 and self._touches_object and not self.is_moving(now)

    def force(self, now: int) -> float:
        return self._force if self.is_gripping(now) else 0.0

    @property
    def collides_at(self) -> int | None:
        """Time in ns at which the fingers hit an object without gripping it; None without a collision."""
        return self.ends if self._touches_object and not self._force else None

    def move(self, goal: float, speed: float, now: int, force: float = 0.0) -> int:
        """Begin to move the fingers to a width of `goal` mm; with a `force` in N, grip an object on the way.
        Return the time in ns at which the motion ends.
        """
        start, thing = self.width(now), self.object_width
        self._touches_object = thing is not None and goal < thing <= start
        self._final_width = thing if thing is not None and self._touches_object else goal
        self._motion = HandMotion.plan(start, goal, now, speed, self.limits.acceleration)
        self.ends = self._motion.time_at_distance(abs(self._final_width - start))
        self._force = force
        self.motion_count += 1
        return self.ends

    def stop(self, now: int, result: int) -> None:
        """Stop the fingers; the call that waits for them returns `result`. A gripped object stays gripped."""
        if self.is_moving(now) or self.collides_at is not None:
            self._final_width = self.width(now)
            self.ends = now
            self._touches_object = False
            self.stopped_by = result
            self.motion_count += 1

    def lose_grip(self) -> None:
        """Release the gripped object, as a hand does when the motor has no power (error 80500371)."""
        self._force = 0.0
        self._touches_object = False


class Equipment:
    """The state of one controller's equipment.

    Attributes:
        hand: COBOTTA's electric hand, which is also the extension `Hand0`.
        gripper: The 2FG hand.
        vacuum: Power of COBOTTA's vacuum hand in percent; 0 while it is off.
        lines: Numbers of the open serial and socket lines.
        brackets: Groups of motions that have not ended: `time` (SyncTimeStart) and `move` (SyncMoveStart).
    """

    def __init__(self, object_width: float | None) -> None:
        self.hand = Hand(COBOTTA_HAND, object_width)
        self.gripper = Hand(TWO_FINGER_HAND, object_width)
        self.vacuum = 0.0
        self.areas: set[int] = set()
        self.lines: set[int] = set()
        self.brackets: set[str] = set()

    def stop(self, now: int) -> None:
        self.hand.stop(now, RefusalCode.HAND_STOPPED)
        self.gripper.stop(now, RefusalCode.HAND_STOPPED)
