"""``bcapscope play``: a trajectory from a file, played in slave mode."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.output_files import check_output_path
from bcapscope.cli.common.play_runner import PlayOutput, PlayRunner
from bcapscope.cli.common.target_options import ControllerTarget, target_options
from bcapscope.cli.common.trajectory_options import TrajectoryOptions, trajectory_options
from bcapscope.live.standard_streams import choose_palette
from bcapscope.player.arm_limits import UNKNOWN_ARM, with_limits
from bcapscope.player.player_messages import PlayPlan, SlaveModePacing
from bcapscope.player.preflight import run_preflight
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.text_format import shortened

_HIGHEST_MODE = 0x303
_NEW_FILE = click.Path(path_type=Path)


def _parse_mode(context: click.Context, parameter: click.Parameter, value: str) -> SlaveModePacing | int:
    """Read a kind of slave mode, or a number as slvChangeMode takes it."""
    text = value.casefold()
    if text in list(SlaveModePacing):
        return SlaveModePacing(text)
    number = parse_integer(text, 1, _HIGHEST_MODE)
    if number is None:
        raise click.BadParameter(f"{shortened(value, 40)!r} is neither sync, async nor a number up to 0x303")
    return number


@click.command(short_help="Play a trajectory in slave mode.")
@trajectory_options
@target_options
@click.option(
    "--mode",
    callback=_parse_mode,
    metavar="MODE",
    default=SlaveModePacing.SYNC.value,
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
    type=options.NumberRange(0.1, 100),
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
    way: TrajectoryOptions,
    target: ControllerTarget,
    mode: SlaveModePacing | int,
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
            check_output_path(path)
    trajectory = way.read_trajectory()
    view = PlayOutput(as_json, choose_palette(color), shutil.get_terminal_size().columns)
    view.show_source(trajectory)
    before = run_preflight(
        trajectory, way.interval / 1000, with_limits(UNKNOWN_ARM, way.limits), loop=way.rounds != 1
    )
    if not before.is_playable:
        view.show_preflight(before)
        sys.exit(ExitCode.UNFIT)
    plan = PlayPlan(
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
        log=_absolute_text(log),
        record=_absolute_text(record),
        realtime=not no_realtime,
    )
    sys.exit(PlayRunner(plan, trajectory, view).run())


def _absolute_text(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())
