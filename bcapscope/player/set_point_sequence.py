"""The row of set points that is sent: those of a trajectory, and how it begins, ends and comes to rest.

The first point is sent a few times before anything moves, so that the controller's buffer is full when it
matters: the first points of a motion are where buffers run empty (issues 20 and 49 of
DENSORobot/denso_robot_ros; nkawa/Denso_CobottaPro900_MQTT_Control sends four). The last one is sent as often,
so that the robot stands when slave mode is left.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

from bcapscope.player.arm_limits import ArmLimits
from bcapscope.player.player_messages import SetPointValues
from bcapscope.player.resampling import stop_after
from bcapscope.player.trajectory import Trajectory


class SetPointSequence:
    """Gives one set point after the other.

    Attributes:
        index: set points of the trajectory that were given, all rounds together, and those of a stop.
        total: how many there are; 0 if there is no end.
        is_stopping: it comes to rest, or has.
    """

    def __init__(
        self, trajectory: Trajectory, period: float, limits: ArmLimits, rounds: int, hold_count: int
    ) -> None:
        """Begin at the first point.

        Args:
            trajectory: with all numbers that slvMove takes; it begins and ends at rest.
            period: seconds from one point to the next.
            limits: of the arm, which a stop keeps within.
            rounds: how often, the first point following the last; 0 without end.
            hold_count: how often the first and the last are sent besides.
        """
        self.index = 0
        self.is_stopping = False
        self.total = len(trajectory) * rounds
        self._trajectory = trajectory
        self._period = period
        self._limits = limits
        self._hold_count = hold_count
        self._remaining = self._all_points()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> SetPointValues:
        return next(self._remaining)

    def stop(self) -> None:
        """Come to rest on the way, then end. Once is enough."""
        if not self.is_stopping:
            self.is_stopping = True
            self._remaining = self._stopping_points()

    def _all_points(self) -> Iterator[SetPointValues]:
        size = len(self._trajectory)
        yield from [self._point_at(0)] * self._hold_count
        while not self.total or self.index < self.total:
            self.index += 1
            yield self._point_at((self.index - 1) % size)
        yield from [self._point_at(size - 1)] * self._hold_count

    def _stopping_points(self) -> Iterator[SetPointValues]:
        if not self.index:
            return
        last, size = self.index - 1, len(self._trajectory)
        again = not self.total or last // size < self.total // size - 1
        way = stop_after(self._trajectory, last % size, self._period, self._limits, loop=again)
        points = [self._point_at(last % size), *(tuple(row) for row in way.tolist())]
        for point in points[1:]:
            self.index += 1
            yield point
        yield from [points[-1]] * self._hold_count

    def _point_at(self, row: int) -> SetPointValues:
        return tuple(self._trajectory.points[row].tolist())
