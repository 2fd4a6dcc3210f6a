"""``bcapscope play``: a trajectory from a file, played in slave mode."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import click

from bcapscope.cli import options
from bcapscope.cli.connection import Target, target
from bcapscope.cli.exits import Exit
from bcapscope.cli.files import check_free
from bcapscope.cli.output import palette
from bcapscope.cli.playing import Playing, View
from bcapscope.cli.way import Way, way
from bcapscope.player.limits import UNKNOWN, limited
from bcapscope.player.messages import Pacing, Plan
from bcapscope.player.preflight import check
from bcapscope.protocol.numerals import read_integer
from bcapscope.protocol.wording import shortened

_HIGHEST_MODE = 0x303
_NEW_FILE = click.Path(path_type=Path)


def _mode(context: click.Context, parameter: click.Parameter, value: str) -> Pacing | int:
    """Read a kind of slave mode, or a number as slvChangeMode takes it."""
    text = value.casefold()
    if text in list(Pacing):
        return Pacing(text)
    number = read_integer(text, 1, _HIGHEST_MODE)
    if number is None:
        raise click.BadParameter(f"{shortened(value, 40)!r} is neither sync, async nor a number up to 0x303")
    return number


@click.command(short_help="Play a trajectory in slave mode.")
@way
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
@click.option("--robot", default="Arm", show_default=True, help="Name for Controller_GetRobot.")
@click.option("--task", default="RobSlave", show_default=True, help="Program that RC7 needs for slave mode.")
@click.option("--move-to-start", is_flag=True, help="Go to the first set point without asking.")
@click.option(
    "--approach",
    metavar="PERCENT",
    type=options.Number(0.1, 100),
    default=10.0,
    show_default=True,
    help="Speed of that motion.",
)
@click.option("--arm", is_flag=True, help="Do not ask whether a robot may be energised and moved.")
@click.option("--dry-run", is_flag=True, help="End after the pre-flight; nothing moves or changes.")
@click.option(
    "--log",
    metavar="FILE.csv",
    type=_NEW_FILE,
    help="Save the controller's own log of the motion, which is emptied first; read over TCP.",
)
@click.option("--record", metavar="FILE.pcapng", type=_NEW_FILE, help="Save what was said as a new capture.")
@click.option("--no-realtime", is_flag=True, help="Do not take real-time priority.")
@click.option("--json", "as_json", is_flag=True, help="The pre-flight and the summary as JSON objects.")
@options.color
def command(
    *,
    way: Way,
    target: Target,
    mode: Pacing | int,
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

    `play` first shows how it read the file, and the problems that it found. Then a process of its
    own starts RobSlave (RC7), takes the arm, switches the motor on, moves to the first set point, enters
    slave mode and sends the set points. At the end it restores the state that it found. The action log
    records the calls that energise or move a robot.

    While it plays, s, space, Ctrl-C or Ctrl-Z lets the robot come to rest on its way; h, Escape twice or
    Ctrl-C twice halts it at once.

    Exit codes: 0 played to the end, or stopped where there is none (--loop 0); 2 invalid command line; 4 the
    file cannot be read; 6 a file was not written; 8 the controller refused something; 9 no answer; 10 the
    motion was not confirmed, or another client moves the robot; 11 the trajectory is not fit to play; 130
    stopped or halted.
    """
    if os.name != "posix":
        raise click.UsageError("the player's process and its signals need Linux, macOS or the like")
    for path in (log, record):
        if path is not None:
            check_free(path)
    trajectory = way.trajectory()
    view = View(as_json, palette(color), shutil.get_terminal_size().columns)
    view.source(trajectory)
    before = check(trajectory, way.interval / 1000, limited(UNKNOWN, way.limits), loop=way.rounds != 1)
    if not before.is_fit:
        view.preflight(before)
        sys.exit(Exit.UNFIT)
    plan = Plan(
        target=target,
        robot=robot,
        task=task,
        kind=trajectory.kind,
        mode=mode,
        period=round(way.interval * 1e6),
        points=list(map(tuple, trajectory.points.tolist())),
        limits=way.limits,
        rounds=way.rounds,
        approach=approach,
        may_approach=move_to_start,
        armed=arm,
        look_only=dry_run,
        log=_absolute(log),
        record=_absolute(record),
        realtime=not no_realtime,
    )
    sys.exit(Playing(plan, trajectory, view).run())


def _absolute(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())
