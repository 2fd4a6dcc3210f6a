"""The row of set points that is sent: those of a trajectory, and how it begins, ends and comes to rest.

The first point is sent a few times before anything moves, so that the controller's buffer is full when it
matters: the first points of a motion are where buffers run empty (issues 20 and 49 of
DENSORobot/denso_robot_ros; nkawa/Denso_CobottaPro900_MQTT_Control sends four). The last one is sent as often,
so that the robot stands when slave mode is left.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

from bcapscope.player.limits import Limits
from bcapscope.player.messages import Point
from bcapscope.player.resampling import stop_after
from bcapscope.player.trajectory import Trajectory


class Course:
    """Gives one set point after the other.

    Attributes:
        index: set points of the trajectory that were given, all rounds together, and those of a stop.
        of: how many there are; 0 if there is no end.
        stopping: it comes to rest, or has.
    """

    def __init__(self, trajectory: Trajectory, period: float, limits: Limits, rounds: int, hold: int) -> None:
        """Begin at the first point.

        Args:
            trajectory: with all numbers that slvMove takes; it begins and ends at rest.
            period: seconds from one point to the next.
            limits: of the arm, which a stop keeps within.
            rounds: how often, the first point following the last; 0 without end.
            hold: how often the first and the last are sent besides.
        """
        self.index = 0
        self.stopping = False
        self.of = len(trajectory) * rounds
        self._trajectory = trajectory
        self._period = period
        self._limits = limits
        self._hold = hold
        self._row = self._whole()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Point:
        return next(self._row)

    def stop(self) -> None:
        """Come to rest on the way, then end. Once is enough."""
        if not self.stopping:
            self.stopping = True
            self._row = self._slower()

    def _whole(self) -> Iterator[Point]:
        size = len(self._trajectory)
        yield from [self._point(0)] * self._hold
        while not self.of or self.index < self.of:
            self.index += 1
            yield self._point((self.index - 1) % size)
        yield from [self._point(size - 1)] * self._hold

    def _slower(self) -> Iterator[Point]:
        if not self.index:
            return
        last, size = self.index - 1, len(self._trajectory)
        again = not self.of or last // size < self.of // size - 1
        way = stop_after(self._trajectory, last % size, self._period, self._limits, loop=again)
        points = [self._point(last % size), *(tuple(row) for row in way.tolist())]
        for point in points[1:]:
            self.index += 1
            yield point
        yield from [points[-1]] * self._hold

    def _point(self, row: int) -> Point:
        return tuple(self._trajectory.points[row].tolist())
