"""Options that say which trajectory to take out of a file and how fast to run through it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import wraps
from pathlib import Path
from typing import Any, NoReturn

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.live.standard_streams import print_stderr
from bcapscope.player.arm_limits import UNKNOWN_ARM, with_limits
from bcapscope.player.column_layout import ReadOptions, parse_columns
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, PoseType
from bcapscope.render.escape import printable
from bcapscope.render.preflight_text import trajectory_line


@dataclass(frozen=True, slots=True)
class TrajectoryOptions:
    """Which trajectory, and how fast.

    Attributes:
        file: path of it.
        index: which of several in the file, from 1; None for the only one.
        pose: pose type to take; None for what there is.
        columns: as `parse_columns` takes it; None to go by titles.
        radians: angles are, where the file does not say.
        metres: positions are, likewise.
        file_interval: ms from one set point of the file to the next, where it does not say.
        interval: ms from one slvMove to the next.
        again: resample to that interval.
        speed: share of the file's.
        rounds: how often; 0 until told to stop.
        limits: of the arm, as `with_limits` takes them.
    """

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
        """Read it.

        Raises:
            click.ClickException: the options make no sense.
            SystemExit: it cannot be read, or not be run through like that; why was told.
        """
        try:
            with_limits(UNKNOWN_ARM, self.limits)
            columns = parse_columns(self.columns) if self.columns else {}
        except ValueError as error:
            raise click.UsageError(str(error)) from None
        kind = None if self.pose is None else PoseType(self.pose)
        wishes = ReadOptions(kind, columns, "rad" if self.radians else "deg", "m" if self.metres else "mm")
        try:
            found = read_trajectories(self.file, wishes)
        except TrajectoryError as error:
            _exit_with(f"{self.file}: {error}", ExitCode.UNREADABLE)
        chosen = self._choose(found)
        if self.file_interval is not None and chosen.period is None and chosen.times is None:
            chosen = replace(chosen, period=self.file_interval / 1000)
        if not self.again and self.speed == 1:
            return chosen
        try:
            return resample(chosen, self.interval / 1000, speed=self.speed)
        except TrajectoryError as error:
            _exit_with(str(error), ExitCode.UNFIT)

    def _choose(self, found: tuple[Trajectory, ...]) -> Trajectory:
        if self.index is None and len(found) > 1:
            lines = "".join(f"\n  {trajectory_line(number, each)}" for number, each in enumerate(found, 1))
            raise click.UsageError(f"{self.file} holds several trajectories, choose one by --index:{lines}")
        if self.index is not None and self.index > len(found):
            raise click.BadParameter(f"{self.file} holds {len(found)}", param_hint="--index")
        return found[(self.index or 1) - 1]


def _exit_with(text: str, code: ExitCode) -> NoReturn:
    print_stderr(f"bcapscope: {printable(text)}")
    raise SystemExit(code)


_OPTIONS = (
    click.option(
        "--index",
        metavar="N",
        type=options.IntegerRange(1, options.LARGEST_COUNT),
        help="Which of several in the file.",
    ),
    click.option("--pose", type=click.Choice([kind.value for kind in PoseType]), help="Pose type to take."),
    click.option("--columns", metavar="AXES", help="Columns, counted from 1: time=1,J1..J6=2..7."),
    click.option("--radians", is_flag=True, help="Angles are in radians where the file does not say."),
    click.option("--metres", is_flag=True, help="Positions are in metres where the file does not say."),
    click.option(
        "--file-interval",
        metavar="MS",
        type=options.NumberRange(0.1),
        help="From one set point of the file to the next, where it does not say.",
    ),
    click.option(
        "--interval",
        metavar="MS",
        type=options.NumberRange(0.5, 1000),
        default=float(PERIOD_MS),
        show_default=True,
        help="From one slvMove to the next.",
    ),
    click.option("--resample", "again", is_flag=True, help="To that interval, with a smooth start and stop."),
    click.option(
        "--speed",
        metavar="SHARE",
        type=options.NumberRange(0.01, 10),
        default=1.0,
        show_default=True,
        help="Of the file's speed; resamples.",
    ),
    click.option(
        "--loop",
        "rounds",
        metavar="N",
        type=options.IntegerRange(0, options.LARGEST_COUNT),
        default=1,
        show_default=True,
        help="Play it N times; 0: until told to stop.",
    ),
    click.option(
        "--limit",
        "limits",
        metavar="LIMIT",
        multiple=True,
        help="Of the arm: J1=-170..170, J1..J3.speed=300, J1.acceleration=6000.",
    ),
)


def trajectory_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the argument FILE and the options; the command is given a `trajectory_options`."""

    @wraps(function)
    def with_way(**given: Any) -> None:
        own = {field.name: given.pop(field.name) for field in fields(TrajectoryOptions)}
        function(way=TrajectoryOptions(**own), **given)

    decorated: Callable[..., None] = with_way
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    return click.argument("file", type=click.Path(path_type=Path))(decorated)
