"""A trajectory made ready: read, brought to the pace, checked; all that can be said before it is played."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bcapscope.client.target import Target
from bcapscope.player.limits import limited, limits_of
from bcapscope.player.messages import Pacing, Plan
from bcapscope.player.preflight import Preflight, check
from bcapscope.player.reading import read
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.protocol.slavemode import PERIOD_MS
from bcapscope.render.palette import Palette
from bcapscope.render.preflight import PreflightRenderer, source_lines, trajectory_line
from bcapscope.tui.words import told


@dataclass(frozen=True, slots=True)
class Wish:
    """What the user wants played.

    Attributes:
        path: of the file or project.
        index: which of several trajectories in it, from 1.
        mode: ``sync``, ``async`` or a number for slvChangeMode.
        interval: ms from one set point to the next.
        speed: share of the file's speed.
        rounds: how often; 0 until told to stop.
        again: resample even where speed and interval are those of the file.
        limits: of the arm, as `player.limits.limited` takes them.
    """

    path: str
    index: int = 1
    mode: Pacing | int = Pacing.SYNC
    interval: float = float(PERIOD_MS)
    speed: float = 1.0
    rounds: int = 1
    again: bool = False
    limits: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Performance:
    """A trajectory that is ready.

    Attributes:
        wish: what was wanted.
        found: all trajectories in the file.
        trajectory: the one that is played.
        preflight: what speaks against it, without knowing where the robot is.
    """

    wish: Wish
    found: tuple[Trajectory, ...]
    trajectory: Trajectory
    preflight: Preflight

    def lines(self, palette: Palette, width: int) -> Iterator[str]:
        """Say how the file was read, what is in it, and what speaks against playing it."""
        yield from source_lines(self.trajectory, told, width)
        if len(self.found) > 1:
            yield from (
                f"  {trajectory_line(number, each, told)}" for number, each in enumerate(self.found, 1)
            )
        yield ""
        yield from PreflightRenderer(palette, width, told).lines(self.preflight)

    def plan(self, target: Target, robot: str, armed: bool, record: Path) -> Plan:
        """Make the plan for the player.

        Args:
            target: the controller.
            robot: its name.
            armed: the user knows that a robot will move.
            record: of all that is said, a new capture.
        """
        wish, trajectory = self.wish, self.trajectory
        return Plan(
            target=target,
            robot=robot,
            kind=trajectory.kind,
            mode=wish.mode,
            period=round(wish.interval * 1e6),
            points=list(map(tuple, trajectory.points.tolist())),
            rounds=wish.rounds,
            armed=armed,
            limits=wish.limits,
            record=str(record),
        )


def prepare(wish: Wish, type_name: str) -> Performance:
    """Read the file, bring it to the pace, and check it. Takes its time.

    Args:
        wish: what is to be played.
        type_name: of the robot; empty where it is not known.

    Raises:
        TrajectoryError: there is nothing to play.
        ValueError: the limits make no sense.
    """
    found = read(wish.path)
    if not 1 <= wish.index <= len(found):
        raise TrajectoryError(f"there are {len(found)} trajectories, and none has number {wish.index}")
    trajectory = found[wish.index - 1]
    if wish.again or wish.speed != 1:
        trajectory = resample(trajectory, wish.interval / 1000, speed=wish.speed)
    limits = limited(limits_of(type_name), wish.limits)
    preflight = check(trajectory, wish.interval / 1000, limits, loop=wish.rounds != 1)
    return Performance(wish, found, trajectory, preflight)
