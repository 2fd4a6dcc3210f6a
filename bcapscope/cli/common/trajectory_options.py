"""Options that choose a trajectory in a file, and the speed at which `play` plays the trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode, exit_with, usage_error_on
from bcapscope.player.arm_limits import UNKNOWN_ARM, with_limits
from bcapscope.player.column_layout import ReadOptions, parse_columns
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType
from bcapscope.protocol.text_format import counted
from bcapscope.render.escape import printable
from bcapscope.render.preflight_text import trajectory_line


@dataclass(frozen=True, slots=True)
class TrajectoryOptions:
    """The trajectory to play. Intervals are in ms. If `rounds` is 0, the motion repeats until stopped."""

    file: Path
    index: int | None
    pose: str | None
    columns: str | None
    radians: bool
    metres: bool
    file_interval: float | None
    interval: float
    again: bool
    speed: float
    rounds: int
    limits: tuple[str, ...]

    def read_trajectory(self) -> Trajectory:
        """Read the trajectory, and resample it if an option requires this. Exit if this fails."""
        with usage_error_on(ValueError):
            with_limits(UNKNOWN_ARM, self.limits)
            columns = parse_columns(self.columns) if self.columns else {}
        kind = None if self.pose is None else PoseType(self.pose)
        wishes = ReadOptions(kind, columns, "rad" if self.radians else "deg", "m" if self.metres else "mm")
        try:
            found = read_trajectories(self.file, wishes)
        except TrajectoryError as error:
            exit_with(printable(f"bcapscope: {self.file}: {error}"), ExitCode.UNREADABLE)
        chosen = self._choose(found)
        if self.file_interval is not None and chosen.period is None and chosen.times is None:
            chosen = replace(chosen, period=self.file_interval / 1000)
        if not self.again and self.speed == 1:
            return chosen
        try:
            return resample(chosen, self.interval / 1000, speed=self.speed)
        except TrajectoryError as error:
            exit_with(printable(f"bcapscope: {error}"), ExitCode.UNFIT)

    def _choose(self, found: tuple[Trajectory, ...]) -> Trajectory:
        if self.index is None and len(found) > 1:
            lines = "".join(f"\n  {trajectory_line(number, each)}" for number, each in enumerate(found, 1))
            reason = f"{self.file} contains several trajectories; choose one with --index:{lines}"
            raise click.UsageError(reason)
        if self.index is not None and self.index > len(found):
            count = counted(len(found), "trajectory", "trajectories")
            raise click.BadParameter(f"{self.file} contains {count}", param_hint="--index")
        return found[(self.index or 1) - 1]


_OPTIONS = (
    click.argument("file", type=click.Path(path_type=Path)),
    click.option(
        "--index",
        metavar="N",
        type=options.IntegerRange(1, options.LARGEST_COUNT),
        help="Choose one of several trajectories in the file; 1 is the first trajectory.",
    ),
    click.option("--pose", type=click.Choice([kind.value for kind in PoseType]), help="Read this pose type."),
    click.option("--columns", metavar="AXES", help="Read these columns, counted from 1: time=1,J1..J6=2..7."),
    click.option("--radians", is_flag=True, help="Read angles as radians if the file names no unit."),
    click.option("--metres", is_flag=True, help="Read positions as metres if the file names no unit."),
    click.option(
        "--file-interval",
        metavar="MS",
        type=options.NumberRange(0.1),
        help="Time in ms from one way-point to the next, if the file has no times.",
    ),
    click.option(
        "--interval",
        metavar="MS",
        type=options.NumberRange(0.5, 1000),
        default=float(PERIOD_MS),
        help="Time in ms from one set point (slvMove) to the next.",
    ),
    click.option(
        "--resample",
        "again",
        is_flag=True,
        help="Resample the trajectory to the interval of --interval, with a smooth start and stop.",
    ),
    click.option(
        "--speed",
        metavar="SHARE",
        type=options.NumberRange(0.01, 10),
        default=1.0,
        help="Play at this multiple of the file's speed. A value other than 1 resamples the trajectory.",
    ),
    click.option(
        "--loop",
        "rounds",
        metavar="N",
        type=options.IntegerRange(0, options.LARGEST_COUNT),
        default=1,
        help="Play the trajectory N times; 0: until you stop it.",
    ),
    options.limit_option("Check the set points against this limit of the arm"),
)

trajectory_options = options.bundled("motion", TrajectoryOptions, _OPTIONS)
"""Adds FILE and the trajectory options. The command gets the argument `motion`, a `TrajectoryOptions`."""
