"""The set points to send: the trajectory, and additional set points at its start, at its end and for a stop.

The player sends the first point a few times, so that the controller's buffer is full when the motion starts.
Otherwise, the buffer may run empty soon after the start (issues 20 and 49 of DENSORobot/denso_robot_ros). The
client in nkawa/Denso_CobottaPro900_MQTT_Control sends the first point four times. The player repeats the last
point, so that the robot has come to rest when slave mode ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

from bcapscope.player.arm_limits import ArmLimits
from bcapscope.player.player_messages import SetPointValues
from bcapscope.player.resampling import stop_after
from bcapscope.player.trajectory import Trajectory


class SetPointSequence:
    """Iterates over the set points.

    Attributes:
        index: Number of set points returned so far, with the set points that bring the robot to rest, but
            without repetitions of the first or last set point.
        total: Total number of set points in all rounds; 0 if the sequence has no end.
        is_stopping: Whether the robot is coming to rest, or has come to rest.
    """

    def __init__(
        self, trajectory: Trajectory, period: float, limits: ArmLimits, rounds: int, hold_count: int
    ) -> None:
        """The trajectory must have every axis that slvMove needs, and begin and end at rest.

        `period` is in seconds. With 0 `rounds`, the sequence has no end. `stop` keeps within `limits`. The
        first and the last point are repeated `hold_count` times.
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
        """Bring the robot to rest instead of sending the remaining set points. Later calls have no effect."""
        if not self.is_stopping:
            self.is_stopping = True
            self._remaining = self._stopping_points()

    def _all_points(self) -> Iterator[SetPointValues]:
        size = len(self._trajectory)
        yield from [self._trajectory.set_point(0)] * self._hold_count
        while not self.total or self.index < self.total:
            self.index += 1
            yield self._trajectory.set_point((self.index - 1) % size)
        yield from [self._trajectory.set_point(size - 1)] * self._hold_count

    def _stopping_points(self) -> Iterator[SetPointValues]:
        if not self.index:
            return
        last, size = self.index - 1, len(self._trajectory)
        again = not self.total or last // size < self.total // size - 1
        way = stop_after(self._trajectory, last % size, self._period, self._limits, loop=again)
        points = [self._trajectory.set_point(last % size), *(tuple(row) for row in way.tolist())]
        for point in points[1:]:
            self.index += 1
            yield point
        yield from [points[-1]] * self._hold_count
