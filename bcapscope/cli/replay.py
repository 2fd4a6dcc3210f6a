"""``bcapscope replay``: one side of a recorded session, played again."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager

import click

from bcapscope.cli import options
from bcapscope.cli.arming import armed_calls, can_ask, confirmed, unarmed
from bcapscope.cli.connection import Target, failures_told, optional_target
from bcapscope.cli.exits import Exit
from bcapscope.cli.output import echo, narrate, palette
from bcapscope.cli.pairing import wanted_calls
from bcapscope.cli.reading import Reading
from bcapscope.cli.serving import Serving, reach
from bcapscope.cli.signals import end_in_order
from bcapscope.client.action_log import LoggedConnection
from bcapscope.client.armed_calls import ArmedCalls
from bcapscope.client.reach import Reach
from bcapscope.client.session import Session
from bcapscope.errors import BcapError
from bcapscope.player.channel import Channel, open_channel
from bcapscope.player.exchanger import BlockingExchanger, Watcher, run
from bcapscope.player.limits import SIMULATED, UNKNOWN, Limits, limited
from bcapscope.player.realtime import undisturbed
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.guard import needs_arming
from bcapscope.protocol.wording import counted
from bcapscope.render.escape import printable
from bcapscope.render.preflight import PreflightRenderer
from bcapscope.render.replay import ReplayRenderer
from bcapscope.replay.performance import Performance, Played
from bcapscope.replay.script import Script, scripts_of
from bcapscope.replay.setpoints import Stretch, UnreadableError, preflight, stretches
from bcapscope.replay.standin import StandIn
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import Filter

_MOST_LISTED = 8


@click.command(short_help="Play one side of a recorded session again.")
@click.argument("capture", type=click.Path(allow_dash=True))
@optional_target
@click.option(
    "--as",
    "side",
    type=click.Choice(["client", "server"]),
    required=True,
    help="Call HOST as the recorded client did, or answer clients as the recorded controller did.",
)
@click.option("--client", metavar="ADDRESS", help="Whose session, by address, or address:port.")
@options.filter_option(RecordKind.CALL)
@click.option("--arm", is_flag=True, help="Do not ask whether a robot may be energised and moved.")
@click.option(
    "--limit",
    "limits",
    metavar="LIMIT",
    multiple=True,
    help="Of the arm: J1=-170..170, J1..J3.speed=300, J1.acceleration=6000.",
)
@click.option("--anywhere", is_flag=True, help="Enter slave mode wherever the robot stands.")
@click.option("--keep-going", is_flag=True, help="Do not end where a call fails that had succeeded.")
@click.option(
    "--longest-pause",
    metavar="SECONDS",
    type=options.Number(0),
    default=5.0,
    show_default=True,
    help="Cut longer pauses between calls.",
)
@click.option("--no-delay", is_flag=True, help="As server: answer at once, not after the recorded time.")
@click.option("--listen", metavar="ADDRESS", default="127.0.0.1", show_default=True, help="As server.")
@click.option("--record", metavar="FILE.pcapng", type=click.Path(dir_okay=False), help="As server.")
@click.option("--json", "as_json", is_flag=True, help="As client: one JSON object a call.")
@click.option("-q", "--quiet", is_flag=True, help="Do not write a line a call.")
@options.color
def command(
    *,
    capture: str,
    target: Target,
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
    record: str | None,
    as_json: bool,
    quiet: bool,
    color: str,
) -> None:
    """Play the client's side of a recorded session to the controller HOST, or the controller's to clients.

    As client, `replay` makes each call at its recorded time, with the handles that this controller gives, and
    compares the result with the recorded one. It retries as this network needs. It first opens what the
    recording uses but does not open. At the end it leaves slave mode and releases everything that is still
    open.

    Before anything is sent the set points go through the pre-flight of `play`. A recording that may energise
    or move a robot needs --arm or your confirmation, except with bcapscope's own simulator. The action log
    records armed calls. `replay` enters slave mode only if the robot is at the first set point, unless you
    give --anywhere.

    As server, `replay` answers a call as the next call like it was answered in the recording.

    Exit codes: 0 all went as recorded; 2 invalid command line; 4 the capture cannot be read, or replay cannot
    listen on the address; 5 there are no calls to play; 6 the capture cannot be written, or is incomplete; 8
    a result differs; 9 no answer; 10 the motion was not confirmed; 11 the set points are not fit to be
    played.
    """
    if side == "client" and not target.host:
        raise click.UsageError("which HOST is to be called?")
    if side == "server" and target.host:
        raise click.UsageError("a server calls nobody: leave HOST out; --listen says where it answers")
    script = _script(Reading([capture], ()), wanted, client)
    if side == "server":
        serving = Serving(quiet=quiet, record=record)
        standin = StandIn(script, serving.log.take, delays=not no_delay)
        with serving.listen(standin, listen, target.port) as server:
            host, port = server.address
            narrate(f"the recorded controller answers on {host} port {port}, UDP and TCP; {reach(host)}")
            serving.serve(server)
        serving.end(_served(serving.log.calls, standin.unknown))
        return
    flight = _Flight(script, limits, color, quiet)
    flight.check(UNKNOWN)
    stage = _Stage(script, flight, keep_going, anywhere, _Teller(as_json, quiet, color))
    with failures_told(target):
        end_in_order()
        with undisturbed():
            code = run(stage.play(target, arm, round(longest_pause * 1e9)))
        sys.exit(code)


def _script(reading: Reading, wanted: Filter | None, client: str | None) -> Script:
    scripts = scripts_of(wanted_calls(reading, wanted))
    reading.summary()
    if client is not None:
        scripts = tuple(script for script in scripts if client in _ends(script))
    if not scripts:
        narrate("no calls are there to play")
        sys.exit(reading.exit or Exit.NOTHING)
    if len(scripts) > 1:
        listed = ", ".join(f"{_ends(script)[0]} ({len(script.lines)})" for script in scripts[:_MOST_LISTED])
        more = f" and {len(scripts) - _MOST_LISTED} more" if len(scripts) > _MOST_LISTED else ""
        raise click.UsageError(f"whose calls? Choose with --client among {listed}{more}")
    return scripts[0]


def _ends(script: Script) -> tuple[str, str]:
    end = script.conversation.client
    return printable(str(end)), printable(end.host)


def _served(calls: int, unknown: int) -> str:
    strange = f", {unknown} of them not in the recording" if unknown else ""
    return f"{counted(calls, 'call')}{strange}"


class _Teller:
    """Writes what came of each call."""

    def __init__(self, as_json: bool, quiet: bool, color: str) -> None:
        self._as_json = as_json
        self._quiet = quiet
        self._renderer = ReplayRenderer(palette(color))

    def __call__(self, played: Played) -> None:
        if self._as_json:
            echo(self._renderer.record(played))
        elif played.differs or not self._quiet:
            echo(self._renderer.line(played))


class _Flight:
    """The pre-flight of a script's set points."""

    def __init__(self, script: Script, limits: tuple[str, ...], color: str, quiet: bool) -> None:
        self._limits = limits
        self._renderer = PreflightRenderer(palette(color), shutil.get_terminal_size().columns)
        self._quiet = quiet
        self.stretches: tuple[Stretch, ...] = ()
        try:
            limited(UNKNOWN, limits)
            self.stretches = tuple(stretches(script))
        except UnreadableError as error:
            narrate(f"bcapscope: {error}: nothing was sent")
            sys.exit(Exit.UNFIT)
        except ValueError as error:
            raise click.UsageError(str(error)) from None

    def check(self, limits: Limits, shown: bool = False) -> None:
        """Check all set points, and show how that went; what is not fit to be played ends the program."""
        found = [preflight(stretch, limited(limits, self._limits)) for stretch in self.stretches]
        bad = [each for each in found if not each.is_fit]
        for each in bad or (found if shown and not self._quiet else ()):
            narrate(each.trajectory.source.form)
            for line in self._renderer.lines(each):
                narrate(line)
        if bad:
            sys.exit(Exit.UNFIT)


class _Stage:
    """Plays a script to a controller and tells how it goes."""

    def __init__(
        self, script: Script, flight: _Flight, keep_going: bool, anywhere: bool, tell: _Teller
    ) -> None:
        self._script = script
        self._flight = flight
        self._keep_going = keep_going
        self._anywhere = anywhere
        self._tell = tell
        self._calls = self._different = self._unanswered = 0
        self._latest = 0

    async def play(self, target: Target, armed: bool, longest_pause: int) -> Exit:
        """Play it without an event loop, which knows no microseconds; return how it went."""
        needs_arm, simulated = self._needs_arming(), False
        if self._flight.stretches or (needs_arm and not armed):
            simulated = await _is_simulator(target)
            self._flight.check(SIMULATED if simulated else UNKNOWN, shown=True)
            if needs_arm and not (armed or simulated or _allowed(target.host)):
                return Exit.UNARMED
        try:
            with ExitStack() as stack:
                log = None
                if needs_arm and not simulated:
                    log = stack.enter_context(armed_calls("replay", LoggedConnection.of_target(target)))
                await self._perform(target, log, longest_pause)
        except ValueError as error:
            raise BcapError(str(error)) from None
        finally:
            self._sum()
        if self._unanswered:
            return Exit.UNANSWERED
        return Exit.REFUSED if self._different else Exit.OK

    async def _perform(self, target: Target, log: ArmedCalls | None, longest_pause: int) -> None:
        async with _session(target, log) as (session, channel):
            reach = Reach(session, target.service, target.connect, {})
            play = Performance(self._script, reach, channel, longest_pause, self._anywhere)
            await play.play(self._told)

    def _needs_arming(self) -> bool:
        return any(needs_arming(line.question.function_id, line.arguments) for line in self._script.lines)

    def _told(self, played: Played) -> bool:
        self._calls += 1
        self._different += played.differs
        self._unanswered += played.unanswered
        self._latest = max(self._latest, played.late)
        self._tell(played)
        return self._keep_going or not played.failed

    def _sum(self) -> None:
        of = len(self._script.lines)
        calls = counted(of, "call") if self._calls == of else f"{self._calls} of {counted(of, 'call')}"
        result = "all as recorded" if not self._different else f"{self._different} with another result"
        narrate(f"{calls} made, {result}; at most {self._latest / 1e6:.1f} ms later than recorded")


async def _is_simulator(target: Target) -> bool:
    async with _session(target) as (session, _):
        return await Reach(session, target.service, target.connect, {}).meets_simulator()


def _allowed(host: str) -> bool:
    """Ask whether a robot may be energised and moved."""
    if can_ask():
        narrate("This is not bcapscope's simulator: the recording may energise or move a robot.")
        if confirmed(host):
            return True
    narrate(printable(f"bcapscope: the recording was not sent. {unarmed(host)}"))
    return False


@asynccontextmanager
async def _session(target: Target, log: ArmedCalls | None = None) -> AsyncIterator[tuple[Session, Channel]]:
    channel = open_channel(target.host, target.port, target.tcp)
    convention = target.convention or (Convention.SEED if channel.datagrams else Convention.TCP0)
    exchanger = BlockingExchanger(channel, convention)
    if log is not None:
        exchanger = BlockingExchanger(channel, convention, _watcher(log))
    session = Session(exchanger, target.paces)
    try:
        yield session, channel
    finally:
        await session.close()


def _watcher(log: ArmedCalls) -> Watcher:
    epoch = time.time_ns() - time.monotonic_ns()
    return lambda sent, raw, at: log.add_frame(sent, raw, at + epoch)
