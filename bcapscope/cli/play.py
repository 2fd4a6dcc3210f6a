"""``bcapscope play``: a trajectory from a file, played in slave mode."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import click

from bcapscope.cli import options
from bcapscope.cli.connection import Target, target
from bcapscope.cli.exits import Exit
from bcapscope.cli.files import check_free
from bcapscope.cli.output import narrate, palette
from bcapscope.cli.playing import Playing, View
from bcapscope.player.layout import Wishes, parse_columns
from bcapscope.player.limits import UNKNOWN, limited
from bcapscope.player.messages import Pacing, Plan
from bcapscope.player.preflight import check
from bcapscope.player.reading import read
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.protocol.slavemode import PERIOD_MS, PoseType
from bcapscope.render.escape import printable
from bcapscope.render.preflight import trajectory_line

_HIGHEST_MODE = 0x303


def _mode(context: click.Context, parameter: click.Parameter, value: str) -> Pacing | int:
    """Read a kind of slave mode, or a number as slvChangeMode takes it."""
    text = value.casefold()
    if text in list(Pacing):
        return Pacing(text)
    try:
        number = int(text, 0)
    except ValueError:
        number = 0
    if not 0 < number <= _HIGHEST_MODE:
        raise click.BadParameter(f"{value!r} is neither sync, async nor a number such as 0x202")
    return number


@click.command(short_help="Play a trajectory in slave mode.")
@click.argument("file", type=click.Path(path_type=Path))
@target
@click.option(
    "--mode",
    callback=_mode,
    metavar="MODE",
    default=Pacing.SYNC.value,
    show_default=True,
    help="sync: the controller sets the pace (Sync on RC7, mode 2 later); async: we do; or the number for "
    "slvChangeMode, such as 0x202.",
)
@click.option(
    "--interval",
    metavar="MS",
    type=click.FloatRange(min=0.5, max=1000),
    default=float(PERIOD_MS),
    show_default=True,
    help="From one slvMove to the next.",
)
@click.option("--resample", "again", is_flag=True, help="To that interval, with a smooth start and stop.")
@click.option(
    "--speed",
    metavar="SHARE",
    type=click.FloatRange(min=0.01, max=10),
    default=1.0,
    show_default=True,
    help="Of the file's speed; resamples.",
)
@click.option(
    "--loop", "rounds", metavar="N", type=click.IntRange(0), default=1, help="Play it N times; 0: until told."
)
@click.option(
    "--index", metavar="N", type=click.IntRange(1), help="Which of several trajectories in the file."
)
@click.option("--pose", type=click.Choice([kind.value for kind in PoseType]), help="Pose type to take.")
@click.option("--columns", metavar="AXES", help="Columns, counted from 1: time=1,J1..J6=2..7.")
@click.option("--radians", is_flag=True, help="Angles are in radians where the file does not say.")
@click.option("--metres", is_flag=True, help="Positions are in metres where the file does not say.")
@click.option(
    "--limit", "limits", metavar="LIMIT", multiple=True, help="Of the arm: J1=-170..170, J1..J3.speed=300."
)
@click.option("--robot", default="Arm", show_default=True, help="Name for Controller_GetRobot.")
@click.option("--task", default="RobSlave", show_default=True, help="Program that RC7 needs for slave mode.")
@click.option("--move-to-start", is_flag=True, help="Go to the first set point without asking.")
@click.option(
    "--approach",
    metavar="PERCENT",
    type=click.FloatRange(min=0.1, max=100),
    default=10.0,
    show_default=True,
    help="Speed of that motion.",
)
@click.option("--arm", is_flag=True, help="A robot may move; else you are asked, except by the simulator.")
@click.option("--dry-run", is_flag=True, help="End after the pre-flight; nothing moves or changes.")
@click.option(
    "--log",
    metavar="FILE.csv",
    type=click.Path(path_type=Path),
    help="Save the controller's own log of the motion, which is emptied first; read over TCP.",
)
@click.option(
    "--record",
    metavar="FILE.pcapng",
    type=click.Path(path_type=Path),
    help="Save what was said as a new capture.",
)
@click.option("--no-realtime", is_flag=True, help="Do not take real-time priority.")
@click.option("--json", "as_json", is_flag=True, help="The pre-flight and the summary as JSON objects.")
@options.color
def command(
    *,
    file: Path,
    target: Target,
    mode: Pacing | int,
    interval: float,
    again: bool,
    speed: float,
    rounds: int,
    index: int | None,
    pose: str | None,
    columns: str | None,
    radians: bool,
    metres: bool,
    limits: tuple[str, ...],
    robot: str,
    task: str,
    move_to_start: bool,
    approach: float,
    arm: bool,
    dry_run: bool,
    log: Path | None,
    record: Path | None,
    no_realtime: bool,
    as_json: bool,
    color: str,
) -> None:
    """Play FILE in slave mode: a control log or other CSV, ROS JointTrajectory as JSON or YAML, what
    `extract` wrote, a capture, or a WINCAPS III project.

    How the file was read and what speaks against playing it is shown first. Then, in a process of its own:
    RobSlave is started (RC7), arm taken, motor switched on, the first set point gone to, slave mode entered,
    the set points sent, and everything left as it was found.

    While it plays, s, space or Ctrl-C lets the robot come to rest on its way; h, Escape twice or Ctrl-C twice
    halts it at once.

    Exit codes: 0 played to the end; 2 the command line makes no sense; 4 the file cannot be read; 6 a file
    was not written; 8 the controller refused something; 9 no answer; 10 nobody said that a robot may move;
    11 the trajectory is not fit to play; 130 stopped or halted.
    """
    for path in (log, record):
        if path is not None:
            check_free(path, overwrite=False)
    try:
        known = limited(UNKNOWN, limits)
        wanted = parse_columns(columns) if columns else {}
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    kind = None if pose is None else PoseType(pose)
    wishes = Wishes(kind, wanted, "rad" if radians else "deg", "m" if metres else "mm")
    trajectory = _read(file, wishes, index)
    if again or speed != 1:
        trajectory = _resampled(trajectory, interval / 1000, speed)
    view = View(as_json, palette(color), shutil.get_terminal_size().columns)
    view.source(trajectory)
    before = check(trajectory, interval / 1000, known, loop=rounds != 1)
    if not before.is_fit:
        view.preflight(before)
        sys.exit(Exit.UNFIT)
    plan = Plan(
        target=target,
        robot=robot,
        task=task,
        kind=trajectory.kind,
        mode=mode,
        period=round(interval * 1e6),
        points=list(map(tuple, trajectory.points.tolist())),
        limits=limits,
        rounds=rounds,
        approach=approach,
        may_approach=move_to_start,
        armed=arm,
        look_only=dry_run,
        log=None if log is None else str(log.absolute()),
        record=None if record is None else str(record.absolute()),
        realtime=not no_realtime,
    )
    sys.exit(Playing(plan, trajectory, view).run())


def _read(file: Path, wishes: Wishes, index: int | None) -> Trajectory:
    """Read the file; where it holds several trajectories one has to be chosen."""
    try:
        found = read(file, wishes)
    except TrajectoryError as error:
        narrate(f"bcapscope: {printable(str(file))}: {printable(str(error))}")
        raise SystemExit(Exit.UNREADABLE) from None
    if index is None and len(found) > 1:
        lines = "".join(f"\n  {trajectory_line(number, each)}" for number, each in enumerate(found, 1))
        raise click.UsageError(f"{file} holds several trajectories, choose one by --index:{lines}")
    if index is not None and index > len(found):
        raise click.BadParameter(f"{file} holds {len(found)}", param_hint="--index")
    return found[(index or 1) - 1]


def _resampled(trajectory: Trajectory, period: float, speed: float) -> Trajectory:
    try:
        return resample(trajectory, period, speed=speed)
    except TrajectoryError as error:
        narrate(f"bcapscope: {printable(str(error))}")
        raise SystemExit(Exit.UNFIT) from None
