"""``bcapscope replay``: play one side of a recording again."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.arming_prompt import (
    can_prompt,
    confirm_robot_may_move,
    log_armed_calls,
    unarmed_reason,
)
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode, exit_on, exit_with, usage_error_on
from bcapscope.cli.common.target_options import ControllerTarget, exit_on_failure, optional_target_options
from bcapscope.client.action_log import ArmedCallLogger, LoggedConnection
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.session import Session
from bcapscope.errors import BcapError, message_of
from bcapscope.live.end_signals import interrupt_on_end_signals
from bcapscope.live.server_runner import ServerRunner, reachability
from bcapscope.live.standard_streams import choose_palette, print_stderr
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.player.arm_limits import SIMULATED_ARM, UNKNOWN_ARM, ArmLimits, with_limits
from bcapscope.player.blocking_caller import (
    BlockingCaller,
    Channel,
    FrameCallback,
    ignore_frame,
    open_channel,
    run_blocking,
)
from bcapscope.player.realtime import realtime_priority
from bcapscope.protocol.guard import needs_arming
from bcapscope.render.color_palette import Palette
from bcapscope.render.escape import printable
from bcapscope.render.preflight_text import PreflightRenderer
from bcapscope.render.reply_text import replayed_line, replayed_record
from bcapscope.replay.recorded_controller import RecordedController
from bcapscope.replay.replay_script import ReplayScript, scripts_of
from bcapscope.replay.script_player import PlayedCall, ScriptPlayer
from bcapscope.replay.set_point_runs import (
    SetPointRun,
    UnreadableSetPointError,
    preflight_run,
    set_point_runs,
)
from bcapscope.simulator.listening_sockets import SimulatorListenError
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind

_MAX_LISTED = 8


@click.command()
@click.argument("capture", type=click.Path(allow_dash=True))
@optional_target_options
@click.option(
    "--as",
    "side",
    type=click.Choice(["client", "server"]),
    required=True,
    help="client: make the calls of the recorded client to HOST. server: give clients the replies of the "
    "recorded controller.",
)
@click.option(
    "--client", metavar="ADDRESS", help="Play the calls of this client, given as address or address:port."
)
@options.filter_option(RecordKind.CALL)
@click.option("--arm", is_flag=True, help="With --as client, energise and move a robot without confirmation.")
@options.limit_option("With --as client, check the set points against this limit of the arm")
@click.option(
    "--anywhere",
    is_flag=True,
    help="With --as client, enter slave mode even if the robot is not at the first set point.",
)
@click.option(
    "--keep-going",
    is_flag=True,
    help="With --as client, continue after a call that fails in the replay but succeeded in the recording.",
)
@click.option(
    "--longest-pause",
    metavar="SECONDS",
    type=options.NumberRange(0),
    default=5.0,
    help="With --as client, shorten longer pauses between calls to this time in seconds.",
)
@click.option(
    "--no-delay",
    is_flag=True,
    help="With --as server, answer immediately instead of after the recorded time.",
)
@click.option(
    "--listen",
    metavar="ADDRESS",
    default="127.0.0.1",
    help="With --as server, listen on this address of this machine.",
)
@options.record_option("With --as server, record the traffic to a new capture.")
@click.option("--json", "as_json", is_flag=True, help="With --as client, print one JSON object per call.")
@click.option(
    "-q",
    "--quiet",
    is_flag=True,
    help="Do not print calls. With --as client, print only results that differ from the recording.",
)
@options.color
@options.language
def command(
    *,
    capture: str,
    target: ControllerTarget,
    side: str,
    client: str | None,
    wanted: Filter | None,
    arm: bool,
    limits: tuple[str, ...],
    anywhere: bool,
    keep_going: bool,
    longest_pause: float,
    no_delay: bool,
    listen: str,
    record: Path | None,
    as_json: bool,
    quiet: bool,
    color: str,
    words: MessageFormatter,
) -> None:
    """Play one side of a recording: make the client's calls to HOST, or give clients the controller's
    replies.

    As client, `replay` first opens each object that the recorded calls use but do not open. `replay` makes
    each call at its recorded time, and compares the result with the recorded result. The calls use the
    handles that HOST gives. Recorded retries are not repeated. At the end, `replay` leaves slave mode and
    releases open objects.

    Before `replay` sends anything, it checks the set points as the pre-flight check of `play` does. A
    recording that may energise or move a robot needs --arm or your confirmation, except with bcapscope's own
    simulator. The action log records the calls that energise or move a robot. `replay` enters slave mode only
    if the robot is at the first set point; --anywhere skips this check.

    As server, `replay` sends recorded replies to clients. Each reply comes from the next recorded call that
    has the request's function, command and arguments. Ctrl-C ends the server. In a shell script, end a
    background `replay` with SIGTERM, as in kill $!. Background jobs of a shell script ignore Ctrl-C.

    Exit codes: 0: all results were as recorded; 2: invalid command line; 3: the capture is damaged and
    contains no calls to play; 4: the capture cannot be read, or replay cannot listen on the address; 5: there
    are no calls to play; 6: the recording cannot be written, or is incomplete; 8: a result differs from the
    recording; 9: no answer; 10: the motion was not confirmed; 11: the set points failed the pre-flight check.
    """
    if side == "client" and not target.host:
        raise click.UsageError("--as client needs a controller: give HOST")
    if side == "server" and target.host:
        raise click.UsageError("--as server takes no HOST: leave HOST out. --listen sets the address")
    script = _choose_script(CaptureReader([capture], (), words=words), wanted, client, words)
    if side == "server":
        serving = ServerRunner(quiet=quiet, record=record, words=words)
        _serve(script, serving, (listen, target.port), not no_delay, words)
        return
    palette = choose_palette(color)
    preflight = _PreflightCheck(script, limits, palette, quiet, words)
    preflight.check(UNKNOWN_ARM)
    runner = _ReplayRunner(script, preflight, keep_going, anywhere, as_json, quiet, palette, words)
    with exit_on_failure(target, words):
        interrupt_on_end_signals()
        with realtime_priority():
            code = run_blocking(runner.play(target, arm, round(longest_pause * 1e9)))
        sys.exit(code)


def _serve(
    script: ReplayScript,
    serving: ServerRunner,
    address: tuple[str, int],
    delays: bool,
    words: MessageFormatter,
) -> None:
    standin = RecordedController(script, serving.log.on_call, delays=delays)
    with exit_on(SimulatorListenError, ExitCode.UNREADABLE), serving.listen(standin, *address) as server:
        host, port = server.address
        print_stderr(words("replay.answers", host=host, port=port, reach=reachability(host)))
        serving.serve(server)
    if not serving.close(_served_text(serving.log.call_count, standin.unknown_calls, words)):
        sys.exit(ExitCode.UNWRITABLE)


def _choose_script(
    reader: CaptureReader, wanted: Filter | None, client: str | None, words: MessageFormatter
) -> ReplayScript:
    scripts = scripts_of(reader.read_calls(wanted))
    reader.print_summary()
    if client is not None:
        scripts = tuple(script for script in scripts if client in _client_names(script))
    if not scripts:
        exit_with(words("replay.no-calls"), reader.exit_code or ExitCode.NO_DATA)
    if len(scripts) > 1:
        listed = ", ".join(
            f"{_client_names(script)[0]} ({len(script.calls)})" for script in scripts[:_MAX_LISTED]
        )
        more = f" and {len(scripts) - _MAX_LISTED} more" if len(scripts) > _MAX_LISTED else ""
        raise click.UsageError(f"the capture has several clients; choose one with --client: {listed}{more}")
    return scripts[0]


def _client_names(script: ReplayScript) -> tuple[str, str]:
    end = script.conversation.client
    return printable(str(end)), printable(end.host)


def _served_text(calls: int, unknown: int, words: MessageFormatter) -> str:
    if unknown:
        return words("replay.served.unknown", calls=Count(calls, "call"), unknown=unknown)
    return words.plural("count.call", calls)


class _PreflightCheck:
    def __init__(
        self,
        script: ReplayScript,
        limits: tuple[str, ...],
        palette: Palette,
        quiet: bool,
        words: MessageFormatter,
    ) -> None:
        self._limits = limits
        self._renderer = PreflightRenderer(palette, shutil.get_terminal_size().columns, words)
        self._quiet = quiet
        self.runs: tuple[SetPointRun, ...] = ()
        with usage_error_on(ValueError):
            with_limits(UNKNOWN_ARM, limits)
        try:
            self.runs = tuple(set_point_runs(script))
        except UnreadableSetPointError as error:
            exit_with(f"bcapscope: {words('replay.nothing-sent', reason=error.message)}", ExitCode.UNFIT)

    def check(self, limits: ArmLimits, shown: bool = False) -> None:
        """Check each series of set points. If a series fails, print the failed series and exit. If no
        series fails, print all series, but only if `shown` is True and --quiet is not set.
        """
        found = [preflight_run(run, with_limits(limits, self._limits)) for run in self.runs]
        bad = [each for each in found if not each.is_playable]
        for each in bad or (found if shown and not self._quiet else ()):
            print_stderr(str(each.trajectory.source.file_format))
            for line in self._renderer.lines(each):
                print_stderr(line)
        if bad:
            sys.exit(ExitCode.UNFIT)


@dataclass(slots=True)
class _ReplayRunner:
    script: ReplayScript
    preflight: _PreflightCheck
    keep_going: bool
    anywhere: bool
    as_json: bool
    quiet: bool
    palette: Palette
    words: MessageFormatter
    _calls: int = 0
    _different: int = 0
    _unanswered: int = 0
    _most_late_ns: int = 0

    async def play(self, target: ControllerTarget, armed: bool, longest_pause: int) -> ExitCode:
        """Make the recorded calls without an event loop, whose timers are too coarse."""
        simulated = False
        needs_arm = any(needs_arming(each.kind.function_id, each.arguments) for each in self.script.calls)
        if self.preflight.runs or (needs_arm and not armed):
            simulated = await _is_simulator(target)
            self.preflight.check(SIMULATED_ARM if simulated else UNKNOWN_ARM, shown=True)
            if needs_arm and not (armed or simulated or _confirm_robot(target.host, self.words)):
                return ExitCode.UNARMED
        try:
            with ExitStack() as stack:
                log = None
                if needs_arm and not simulated:
                    log = stack.enter_context(log_armed_calls("replay", LoggedConnection.of_target(target)))
                async with _session(target, log) as (session, channel):
                    opener = ObjectOpener(session, target)
                    player = ScriptPlayer(self.script, opener, channel, longest_pause, self.anywhere)
                    await player.play(self._on_played)
        except ValueError as error:
            raise BcapError(message_of(error)) from None
        finally:
            self._print_summary()
        if self._unanswered:
            return ExitCode.UNANSWERED
        return ExitCode.REFUSED if self._different else ExitCode.OK

    def _on_played(self, played: PlayedCall) -> bool:
        self._calls += 1
        self._different += played.differs
        self._unanswered += played.unanswered
        self._most_late_ns = max(self._most_late_ns, played.delay)
        if self.as_json:
            echo(replayed_record(played))
        elif played.differs or not self.quiet:
            echo(replayed_line(played, self.palette, self.words))
        return self.keep_going or not played.failed

    def _print_summary(self) -> None:
        words, total = self.words, Count(len(self.script.calls), "call")
        calls = Message("replay.calls.all", calls=total)
        if self._calls != total.value:
            calls = Message("replay.calls.some", made=self._calls, calls=total)
        result = Message("replay.result.same")
        if self._different:
            result = Message("replay.result.differs", n=self._different)
        late = f"{self._most_late_ns / 1e6:.1f}"
        print_stderr(words("replay.summary", calls=calls, result=result, late=late))


async def _is_simulator(target: ControllerTarget) -> bool:
    async with _session(target) as (session, _):
        return await ObjectOpener(session, target).is_simulator()


def _confirm_robot(host: str, words: MessageFormatter) -> bool:
    if can_prompt():
        print_stderr(words("replay.may-move"))
        if confirm_robot_may_move(host, words):
            return True
    unsent = words("replay.not-sent", reason=unarmed_reason(host))
    print_stderr(printable(f"bcapscope: {unsent}"))
    return False


@asynccontextmanager
async def _session(
    target: ControllerTarget, log: ArmedCallLogger | None = None
) -> AsyncIterator[tuple[Session, Channel]]:
    channel = open_channel(target.host, target.port, target.tcp)
    convention = target.convention_for(channel.datagrams)
    on_frame = ignore_frame if log is None else _log_watcher(log)
    session = Session(BlockingCaller(channel, convention, on_frame), target.retry_policies)
    try:
        yield session, channel
    finally:
        await session.close()


def _log_watcher(log: ArmedCallLogger) -> FrameCallback:
    epoch = time.time_ns() - time.monotonic_ns()
    return lambda sent, raw, at: log.add_frame(sent, raw, at + epoch)
