"""A trajectory that has been read, resampled and checked before it is played."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.messages import Message
from bcapscope.player.arm_limits import limits_for_arm, with_limits
from bcapscope.player.player_messages import PlayPlan, SlaveModePacing
from bcapscope.player.preflight import PreflightResult, run_preflight
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.slave_mode.modes import PERIOD_MS
from bcapscope.render.color_palette import Palette
from bcapscope.render.preflight_text import PreflightRenderer, source_lines, trajectory_line
from bcapscope.tui.reader_language import reader_words


@dataclass(frozen=True, slots=True)
class PlaybackSettings:
    """The user's settings for playing a trajectory.

    Attributes:
        index: Number of the trajectory in the file, from 1.
        interval: Cycle time in ms.
        speed: Speed as a fraction of the speed in the file.
        rounds: Number of repetitions; 0 repeats until stopped.
        always_resample: Whether to resample even if speed and interval are those of the file.
        limits: Arm limits in the notation of `player.arm_limits.with_limits`.
    """

    path: str
    index: int = 1
    mode: SlaveModePacing | int = SlaveModePacing.SYNC
    interval: float = float(PERIOD_MS)
    speed: float = 1.0
    rounds: int = 1
    always_resample: bool = False
    limits: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PreparedTrajectory:
    """A trajectory that is ready to play. The pre-flight check does not yet know the robot's position."""

    settings: PlaybackSettings
    all_trajectories: tuple[Trajectory, ...]
    trajectory: Trajectory
    preflight: PreflightResult

    def summary_lines(self, palette: Palette, width: int) -> Iterator[str]:
        """Yield lines on how the file was read, its content, and problems with playing it."""
        yield from source_lines(self.trajectory, reader_words(), width)
        if len(self.all_trajectories) > 1:
            yield from (
                f"  {trajectory_line(number, each, reader_words())}"
                for number, each in enumerate(self.all_trajectories, 1)
            )
        yield ""
        yield from PreflightRenderer(palette, width, reader_words()).lines(self.preflight)

    def make_plan(self, target: ControllerTarget, robot: str, armed: bool, record: Path) -> PlayPlan:
        """Return the plan to pass to the player process.

        Args:
            armed: Whether the user confirmed that the robot may move.
            record: Name of a new file for recording the whole conversation.
        """
        wish, trajectory = self.settings, self.trajectory
        return PlayPlan(
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


def prepare_trajectory(settings: PlaybackSettings, type_name: str) -> PreparedTrajectory:
    """Read a trajectory file, resample the trajectory and check it. This can take long.

    Args:
        type_name: Type of the robot; empty if unknown.

    Raises:
        TrajectoryError: The file contains nothing that can be played.
        ValueError: The limits are invalid.
    """
    found = read_trajectories(settings.path)
    if not 1 <= settings.index <= len(found):
        raise TrajectoryError(Message("trajectory.no-such-number", count=len(found), number=settings.index))
    trajectory = found[settings.index - 1]
    if settings.always_resample or settings.speed != 1:
        trajectory = resample(trajectory, settings.interval / 1000, speed=settings.speed)
    limits = with_limits(limits_for_arm(type_name), settings.limits)
    preflight = run_preflight(trajectory, settings.interval / 1000, limits, loop=settings.rounds != 1)
    return PreparedTrajectory(settings, found, trajectory, preflight)
