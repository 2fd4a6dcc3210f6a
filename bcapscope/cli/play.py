"""``bcapscope play``: move a robot along a trajectory from a file, in slave mode."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.output_files import check_output_path
from bcapscope.cli.common.play_runner import PlayOutput, PlayRunner
from bcapscope.cli.common.target_options import target_options
from bcapscope.cli.common.trajectory_options import TrajectoryOptions, trajectory_options
from bcapscope.client.controller_target import DEFAULT_ROBOT, ROBSLAVE
from bcapscope.live.standard_streams import choose_palette
from bcapscope.messages import MessageFormatter
from bcapscope.player.arm_limits import UNKNOWN_ARM, with_limits
from bcapscope.player.player_messages import PlayPlan, SlaveModePacing
from bcapscope.player.preflight import run_preflight
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.text_format import shortened

_HIGHEST_MODE = 0x303
_NEW_FILE = click.Path(path_type=Path)


def _parse_mode(context: click.Context, parameter: click.Parameter, value: str) -> SlaveModePacing | int:
    text = value.casefold()
    if text in list(SlaveModePacing):
        return SlaveModePacing(text)
    number = parse_integer(text, 1, _HIGHEST_MODE)
    if number is None:
        reason = f"{shortened(value, 40)!r} is not a slave mode. Give sync, async, or a number up to 0x303"
        raise click.BadParameter(reason)
    return number


@click.command(short_help="Move a robot along a trajectory in slave mode.")
@trajectory_options
@target_options
@click.option(
    "--mode",
    callback=_parse_mode,
    metavar="MODE",
    default=SlaveModePacing.SYNC.value,
    help="Use this slave mode. sync: the controller sets the pace (Sync on RC7, mode 2 on later "
    "controllers). async: `play` sets the pace. You can also give the number for slvChangeMode, "
    "such as 0x202.",
)
@click.option("--robot", default=DEFAULT_ROBOT, help="Open the robot with this name.")
@click.option("--task", default=ROBSLAVE, help="Start this task. On RC7, slave mode needs this task.")
@click.option(
    "--move-to-start", "may_approach", is_flag=True, help="Move to the first set point without confirmation."
)
@click.option(
    "--approach",
    metavar="PERCENT",
    type=options.NumberRange(0.1, 100),
    default=10.0,
    help="Move to the first set point at this speed, in percent.",
)
@click.option("--arm", "armed", is_flag=True, help="Energise and move a robot without confirmation.")
@click.option(
    "--dry-run", "look_only", is_flag=True, help="Stop after the pre-flight check; nothing moves or changes."
)
@click.option(
    "--log",
    metavar="FILE.csv",
    type=_NEW_FILE,
    help="Save the controller's own log of the motion. `play` clears this log first, and reads it over TCP.",
)
@click.option("--record", metavar="FILE.pcapng", type=_NEW_FILE, help="Record the traffic to a new capture.")
@click.option("--no-realtime", is_flag=True, help="Run without real-time priority.")
@click.option("--json", "as_json", is_flag=True, help="Print the pre-flight check and the summary as JSON.")
@options.color
@options.language
def command(
    *,
    motion: TrajectoryOptions,
    log: Path | None,
    record: Path | None,
    no_realtime: bool,
    as_json: bool,
    color: str,
    words: MessageFormatter,
    **planned: Any,
) -> None:
    """Move the robot of HOST along the set points of FILE, in slave mode.

    FILE is a control log or other CSV table, a ROS JointTrajectory as JSON or YAML, output of `extract`, a
    capture, or a WINCAPS III project.

    `play` first shows how it understood the file, and the problems that the pre-flight check found. A
    separate process then starts RobSlave (RC7), takes the arm and switches the motor on. The process moves
    the robot to the first set point, enters slave mode and sends the set points. At the end, the process
    restores the original state. The action log records the calls that energise or move a robot.

    While `play` runs, press s, space, Ctrl-C or Ctrl-Z to bring the robot to rest on its path. Press h,
    Escape twice or Ctrl-C twice to halt the robot at once.

    Exit codes: 0: the trajectory was played to its end, or you stopped it with --loop 0; 2: invalid command
    line; 4: the file cannot be read; 6: a file was not written; 8: the controller refused a call; 9: no
    answer; 10: the motion was not confirmed, or another client moves the robot; 11: the trajectory failed the
    pre-flight check; 130: stopped or halted.
    """
    if os.name != "posix":
        raise click.UsageError("play needs POSIX signals: run it on Linux or macOS")
    for path in filter(None, (log, record)):
        check_output_path(path)
    trajectory = motion.read_trajectory()
    view = PlayOutput(as_json, choose_palette(color), shutil.get_terminal_size().columns, words)
    view.show_source(trajectory)
    _check_motion(trajectory, motion, view)
    plan = PlayPlan(
        kind=trajectory.kind,
        period=round(motion.interval * 1e6),
        points=list(map(tuple, trajectory.points.tolist())),
        limits=motion.limits,
        rounds=motion.rounds,
        log=_absolute_text(log),
        record=_absolute_text(record),
        realtime=not no_realtime,
        **planned,
    )
    sys.exit(PlayRunner(plan, trajectory, view).run())


def _check_motion(trajectory: Trajectory, motion: TrajectoryOptions, view: PlayOutput) -> None:
    """Check the set points with the limits of --limit only, because no other limits are known yet."""
    before = run_preflight(
        trajectory, motion.interval / 1000, with_limits(UNKNOWN_ARM, motion.limits), loop=motion.rounds != 1
    )
    if not before.is_playable:
        view.show_preflight(before)
        sys.exit(ExitCode.UNFIT)


def _absolute_text(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())
