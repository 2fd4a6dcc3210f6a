"""``bcapscope play``: move a robot along a trajectory from a file, in slave mode."""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
from collections.abc import Iterable
from pathlib import Path
from types import FrameType
from typing import Any

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.arming_prompt import (
    can_prompt,
    confirm_robot_may_move,
    log_armed_calls,
    prompt_line,
)
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.output_files import check_output_path
from bcapscope.cli.common.target_options import target_options
from bcapscope.cli.common.trajectory_options import TrajectoryOptions, trajectory_options
from bcapscope.client.action_log import LoggedConnection
from bcapscope.client.controller_target import DEFAULT_ROBOT, ROBSLAVE
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.live.terminal_keys import TerminalKeys
from bcapscope.messages import MessageFormatter
from bcapscope.player.arm_limits import UNKNOWN_ARM, with_limits
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayEnded,
    PlayerMessage,
    PlayerProblem,
    PlayerQuestion,
    PlayOutcome,
    PlayPlan,
    PlayProgress,
    PlayState,
    QuestionTopic,
    SlaveModePacing,
)
from bcapscope.player.player_process import ArmedMessageLogger, PlayerProcess
from bcapscope.player.preflight import PreflightResult, run_preflight, run_preflight_for
from bcapscope.player.realtime import RealtimeReport
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.text_format import shortened
from bcapscope.render.color_palette import Palette
from bcapscope.render.escape import printable
from bcapscope.render.play_text import (
    controller_line,
    play_summary_lines,
    play_summary_record,
    progress_line,
    trouble_lines,
)
from bcapscope.render.preflight_text import PreflightRenderer, preflight_record, source_lines

_EXIT_CODES = {
    PlayOutcome.DONE: ExitCode.OK,
    PlayOutcome.LOOKED: ExitCode.OK,
    PlayOutcome.STOPPED: ExitCode.INTERRUPTED,
    PlayOutcome.HALTED: ExitCode.INTERRUPTED,
    PlayOutcome.UNARMED: ExitCode.UNARMED,
    PlayOutcome.DECLINED: ExitCode.UNARMED,
    PlayOutcome.UNFIT: ExitCode.UNFIT,
    PlayOutcome.REFUSED: ExitCode.REFUSED,
    PlayOutcome.UNANSWERED: ExitCode.UNANSWERED,
    PlayOutcome.UNWRITABLE: ExitCode.UNWRITABLE,
    PlayOutcome.FAILED: ExitCode.UNANSWERED,
}
_STOP_KEYS = "s "
_HALT_KEYS = ("h", "\x1b\x1b")
_POLL_INTERVAL = 1.0
_TERMINAL_CLOSED = getattr(signal, "SIGHUP", None)

_HIGHEST_MODE = 0x303
_NEW_FILE = click.Path(path_type=Path)


def _parse_mode(value: str) -> SlaveModePacing | int:
    text = value.casefold()
    if text in list(SlaveModePacing):
        return SlaveModePacing(text)
    number = parse_integer(text, 1, _HIGHEST_MODE)
    if number is None:
        name = repr(shortened(value, 40))
        raise ValueError(f"{name} is not a slave mode. Give sync, async, or a number up to 0x303")
    return number


@click.command()
@trajectory_options
@target_options
@click.option(
    "--mode",
    callback=options.parsed_by(_parse_mode),
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
    help="Save the controller's own log of the motion. Before the motion, `play` clears the controller's "
    "log. After the motion, `play` reads the controller's log over TCP.",
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

    `play` first shows how it understood the file, and the problems that the pre-flight check found. After
    that, a separate process on this computer, the player, starts RobSlave (RC7), takes the arm and switches
    the motor on. The player moves the robot to the first set point, enters slave mode and sends the set
    points. At the end, `play` restores the state that it found at its start. The action log records the calls
    that energise or move a robot.

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
    """Exit if a set point violates --limit. The limits of the controller are not known yet."""
    before = run_preflight(
        trajectory, motion.interval / 1000, with_limits(UNKNOWN_ARM, motion.limits), loop=motion.rounds != 1
    )
    if not before.is_playable:
        view.show_preflight(before)
        sys.exit(ExitCode.UNFIT)


def _absolute_text(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())


class PlayOutput:
    """Prints the output of `play`: data to stdout, all other text to stderr."""

    def __init__(self, as_json: bool, palette: Palette, width: int, words: MessageFormatter) -> None:
        self.words = words
        self._json = as_json
        self._palette = palette
        self._width = width
        self._draws_progress = sys.stderr.isatty() and not as_json
        self._is_drawn = False
        self._is_closed = False

    def close(self) -> None:
        """Ignore all further output, because the terminal was closed."""
        self._is_closed = True

    def show_source(self, trajectory: Trajectory) -> None:
        if not self._json:
            for line in source_lines(trajectory, self.words):
                echo(line)

    def show_preflight(self, preflight: PreflightResult) -> None:
        renderer = PreflightRenderer(self._palette, self._width, self.words)
        self._print_data([preflight_record(preflight)] if self._json else renderer.lines(preflight))

    def show_end(self, ended: PlayEnded) -> None:
        self._erase_progress()
        self._print_data(
            [play_summary_record(ended)] if self._json else play_summary_lines(ended, self.words)
        )

    def print_line(self, text: str) -> None:
        self._erase_progress()
        if not self._is_closed:
            print_stderr(text)

    def draw_progress(self, progress: PlayProgress) -> None:
        if self._draws_progress and not self._is_closed:
            sys.stderr.write(f"\r{progress_line(progress, self._width - 1, self.words)}\x1b[K")
            sys.stderr.flush()
            self._is_drawn = True

    def _erase_progress(self) -> None:
        if self._is_drawn and not self._is_closed:
            sys.stderr.write("\r\x1b[K")
            self._is_drawn = False

    def _print_data(self, lines: Iterable[str | bytes]) -> None:
        for line in lines:
            if not self._is_closed:  # the terminal can be closed between two lines
                echo(line)


class PlayRunner:
    def __init__(self, plan: PlayPlan, trajectory: Trajectory, output: PlayOutput) -> None:
        self._plan = plan
        self._trajectory = trajectory
        self._output = output
        self._keys = TerminalKeys()
        self._is_prompting = False
        self._stop_requested = False
        self._is_fit = True
        self._can_prompt = can_prompt()

    def run(self) -> ExitCode:
        connection = LoggedConnection.of_target(self._plan.target)
        with log_armed_calls("play", connection) as calls, PlayerProcess(self._plan) as player:
            self._player, self._log = player, ArmedMessageLogger(calls)
            before = {number: signal.signal(number, self._on_signal) for number in _handled_signals()}
            try:
                while player.ended is None:
                    for message in self._wait_for_messages():
                        self._on_message(message)
                self._keys.stop()
                return self._finish(player.close())
            finally:
                self._keys.stop()
                for number, handler in before.items():
                    signal.signal(number, handler)

    def _finish(self, ended: PlayEnded) -> ExitCode:
        if self._plan.look_only and ended.outcome is PlayOutcome.LOOKED:
            return ExitCode.OK if self._is_fit else ExitCode.UNFIT
        self._output.show_end(ended)
        if not self._is_fit:
            return ExitCode.UNFIT
        if ended.outcome is PlayOutcome.STOPPED and ended.index and not self._plan.rounds:
            return ExitCode.OK  # with --loop 0, the motion ends only when the user stops it
        return _EXIT_CODES[ended.outcome]

    def _wait_for_messages(self) -> list[PlayerMessage]:
        """Wait for messages and keys, and handle stop and halt keys. Return the player's messages."""
        watched = [self._player.fileno(), *([0] if self._keys.is_on else [])]
        ready, _, _ = select.select(watched, (), (), _POLL_INTERVAL)
        if 0 in ready:
            typed = self._keys.read_keys()
            if any(key in typed for key in _HALT_KEYS):
                self._player.halt()
            elif any(key in typed for key in _STOP_KEYS):
                self._player.stop()
        return self._player.read_messages()

    def _on_message(self, message: PlayerMessage) -> None:
        self._log.on_message(message)
        if isinstance(message, PlayProgress):
            if message.state is PlayState.PLAYING and not self._keys.is_on:
                self._keys.start()
            self._output.draw_progress(message)
        elif isinstance(message, PlayerQuestion):
            self._player.answer(self._answer_prompt(message))
        elif isinstance(message, ControllerInfo):
            self._check_trajectory(message)
        elif isinstance(message, RealtimeReport) and not self._plan.look_only:
            self._output.print_line(printable(self._output.words.text(message.text)))
        elif isinstance(message, PlayerProblem):
            for line in trouble_lines(message, self._output.words):
                self._output.print_line(line)

    def _check_trajectory(self, peer: ControllerInfo) -> None:
        self._output.print_line(controller_line(peer, self._output.words))
        found = run_preflight_for(self._trajectory, self._plan, peer)
        self._output.show_preflight(found)
        self._is_fit = found.is_playable

    def _answer_prompt(self, call_kind: PlayerQuestion) -> str:
        if call_kind.topic is QuestionTopic.BEGIN:
            if self._is_fit:
                hint = "play.keys" if self._can_prompt else "play.keys.signals"
                self._output.print_line(self._output.words(hint))
            return "yes" if self._is_fit else "no"
        self._output.print_line(printable(self._output.words.text(call_kind.text)))
        if not self._can_prompt:
            return call_kind.choices[0]
        self._keys.stop()
        self._is_prompting = True
        try:
            return self._prompt_user(call_kind)
        except (KeyboardInterrupt, click.Abort):
            self._is_prompting = False
            self._output.print_line("")
            if not self._stop_requested:
                self._player.stop()
            return call_kind.choices[0]
        finally:
            self._is_prompting = False

    def _prompt_user(self, call_kind: PlayerQuestion) -> str:
        if call_kind.topic is QuestionTopic.ARM:
            may_move = confirm_robot_may_move(self._plan.target.host, self._output.words)
            return "yes" if may_move else "no"
        choices = call_kind.choices
        question = f"{self._output.words('play.answer')} ({', '.join(choices)}) [{choices[0]}]"
        while (choice := prompt_line(question) or choices[0]) not in choices:
            pass
        return choice

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        """Stop the robot at the first signal, and halt it at the second signal."""
        if number == _TERMINAL_CLOSED:
            self._output.close()
        # Set `_stop_requested` before `stop`: a second signal can interrupt `stop`, and must halt the robot.
        again, self._stop_requested = self._stop_requested, True
        if again:
            self._player.halt()
        else:
            self._player.stop()
        if self._is_prompting:
            raise KeyboardInterrupt  # ends the prompt


def _handled_signals() -> list[signal.Signals]:
    # An unhandled Ctrl-Z would suspend this process while the robot moves on, and keys would have no effect.
    # An unhandled Ctrl-\ would end this process without a summary.
    numbers = [signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGTSTP]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup ignores SIGHUP
        numbers.append(signal.SIGHUP)
    return numbers
