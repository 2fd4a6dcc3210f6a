"""``bcapscope sim``: simulate a controller without a robot."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.attended import announce_ready, attended_option
from bcapscope.cli.common.exit_codes import ExitCode, exit_on
from bcapscope.faults.document import DocumentError
from bcapscope.live.server_runner import ServerRunner, reachability
from bcapscope.live.standard_streams import can_poll_stdin, print_stderr
from bcapscope.messages import Message, MessageFormatter
from bcapscope.render.columns import align_columns
from bcapscope.render.escape import printable
from bcapscope.simulator.behaviours import read_behaviours
from bcapscope.simulator.controller_setup import ScenarioProfileError, played_scenario, start_controller
from bcapscope.simulator.listening_sockets import SimulatorListenError
from bcapscope.simulator.profile import DEFAULT_PROFILE, PROFILES, NoArgument
from bcapscope.simulator.scenario import ClientProgram, Scenario, ServerDefect, load_scenario, read_scenario
from bcapscope.simulator.scenario_files import bundled_scenarios
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.simulator_server import SimulatorServer

_WIDTH = 98
_SESSION_TEXTS = {
    ClientProgram.CALLS: "makes a few calls",
    ClientProgram.MOTION: "moves the robot",
    ClientProgram.SLAVE: "enters slave mode 0x{:03X}",
    ClientProgram.PASSING: "enters slave mode 0x{:03X} after a motion with @P",
    ClientProgram.GRIPPER: "stays in slave mode 0x{:03X} while a second client writes an output",
}
"""What a client does. Each text continues the sentence "To see what happens, connect a client that"."""


def _choose_scenario(context: click.Context, param: click.Parameter, named: str | None) -> Scenario | None:
    if named is None:
        return None
    try:
        return load_scenario(named)
    except DocumentError as error:
        raise click.BadParameter(f"{named}: {error}") from None
    except LookupError as error:
        hint = "--scenarios lists all names. A scenario file must end in .yaml or .yml"
        raise click.BadParameter(f"{error.args[0]} {hint}") from None
    except OSError as error:
        raise click.BadParameter(f"cannot read {named}: {error.strerror or error}") from None


def _scenario_lines() -> Iterator[str]:
    scenarios = ((name, read_scenario(text)) for name, text in bundled_scenarios().items())
    rows = [(name, scenario.shows or "", scenario.title) for name, scenario in scenarios]
    return align_columns([("NAME", "ROOT CAUSE", "WHAT IT SHOWS"), *rows], "<<<")


def _behaviour_lines() -> Iterator[str]:
    head = ("BEHAVIOUR", "CERTAINTY", "WHAT THE SIMULATOR DOES, OR WHEN IT RETURNS THE RESULT", "SOURCE")
    rows = [(each.name, each.certainty, each.text, each.source) for each in read_behaviours()]
    return align_columns([head, *rows], "<<<<")


@click.command()
@click.option(
    "--profile",
    type=click.Choice(list(PROFILES)),
    help="Simulate this kind of controller. Default: the profile of the scenario; without a scenario, "
    f"{DEFAULT_PROFILE}.",
)
@click.option(
    "--scenario",
    callback=_choose_scenario,
    metavar="NAME|FILE.yaml",
    help="Play a scenario: begin in the state of the scenario and inject its faults.",
)
@options.text_option("--scenarios", _scenario_lines, "List the scenarios and exit.")
@options.text_option(
    "--behaviours",
    _behaviour_lines,
    "List the simulated behaviours with their certainty and sources, and exit.",
)
@click.option(
    "--seed",
    type=options.IntegerRange(0, options.LARGEST_SEED),
    help="Use this random seed instead of the seed of the scenario.",
)
@click.option(
    "--defect",
    "defects",
    multiple=True,
    type=click.Choice([each.value for each in ServerDefect]),
    help="Simulate this defect of DENSO's C server; may be repeated. By default, the profile cserver has all "
    "defects, and the other profiles have no defects.",
)
@click.option(
    "--no-argument",
    type=click.Choice([each.value for each in NoArgument]),
    help='Omit the EMPTY VARIANT from replies that have no value: "never", "slvchangemode" (only from '
    'replies to slvChangeMode) or "always". By default, the profile rc7 uses "slvchangemode", and the '
    'other profiles use "never".',
)
@click.option("--listen", metavar="HOST", default="127.0.0.1", help="Listen on this address of this machine.")
@click.option(
    "-p",
    "--port",
    type=options.IntegerRange(0, 65535),
    default=5007,
    help="Listen on this port, UDP and TCP; 0 chooses a free port.",
)
@options.record_option("Record the traffic to a new capture, or to a named pipe that a program reads.")
@click.option("-q", "--quiet", is_flag=True, help="Do not print the calls.")
@attended_option
@options.language
def command(
    *,
    profile: str | None,
    scenario: Scenario | None,
    seed: int | None,
    defects: tuple[str, ...],
    no_argument: str | None,
    listen: str,
    port: int,
    record: Path | None,
    quiet: bool,
    attended: bool,
    words: MessageFormatter,
) -> None:
    """Simulate a DENSO controller: answer b-CAP clients over UDP and TCP until Ctrl-C.

    `sim` prints one line per call. While `sim` runs, you can type commands. "reset" forgets all clients, as
    Reset on the pendant does. "stop" presses the emergency stop, and "go" releases the emergency stop.
    "detector" turns on or off the detection of late set points in the Async modes of RC7. "quit" ends `sim`.
    In a shell script, end a background `sim` with SIGTERM, as in kill $!. The background jobs of a shell
    script ignore Ctrl-C (SIGINT).

    --scenario simulates a controller with a known problem. `diagnose` finds the root cause in a capture of
    the traffic. Lines that begin with # show what the scenario does.

    Exit codes: 0: you ended `sim`; 2: invalid command line or scenario; 4: `sim` cannot listen on the
    address;
    6: the recording cannot be written, or is incomplete.
    """
    played = _played_scenario(scenario, profile, defects, no_argument)
    serving = ServerRunner(quiet=quiet, record=record, words=words)
    log = serving.log
    simulator, served = start_controller(played, seed, on_call=log.on_call, on_news=log.add_note)
    exits = exit_on(SimulatorListenError, ExitCode.UNREADABLE)
    with exits, serving.listen(served, listen, port) as server:
        _print_introduction(simulator, server, scenario, words)
        if attended:
            announce_ready(["%s:%d" % server.address])

        def print_message(id: str) -> None:
            serving.print_message(words(id))

        keys = _TypedCommands(_actions(simulator, server, print_message), print_message, attended)
        serving.serve(server, keys.read_commands, keys.watched)
    overrun = server.datagram_queue.dropped
    summary = words(
        "sim.summary.overrun" if overrun else "sim.summary",
        calls=serving.log.call_count,
        dropped=simulator.dropped,
        overrun=overrun,
    )
    if not serving.close(summary):
        sys.exit(ExitCode.UNWRITABLE)


def _print_introduction(
    simulator: Simulator, server: SimulatorServer, scenario: Scenario | None, words: MessageFormatter
) -> None:
    print_stderr(words.text(_greeting(simulator, server)))
    print_stderr(words("sim.commands"))
    if scenario is not None:
        print_stderr(_scenario_introduction(scenario))


def _played_scenario(
    scenario: Scenario | None, profile: str | None, defects: tuple[str, ...], no_argument: str | None
) -> Scenario:
    try:
        return played_scenario(
            scenario,
            profile,
            defects=tuple(map(ServerDefect, defects)),
            no_argument=None if no_argument is None else NoArgument(no_argument),
        )
    except ScenarioProfileError as error:
        raise click.UsageError(f"{error}: leave out --profile") from None


def _greeting(simulator: Simulator, server: SimulatorServer) -> Message:
    host, port = server.address
    profile = simulator.machine.profile
    return Message("sim.greeting", profile=profile.title, host=host, port=port, reach=reachability(host))


def _quit() -> None:
    raise KeyboardInterrupt


def _actions(
    simulator: Simulator, server: SimulatorServer, print_message: Callable[[str], None]
) -> dict[str, Callable[[], None]]:
    machine = simulator.machine

    def reset() -> None:
        server.reset()
        print_message("sim.reset")

    def press() -> None:
        machine.press_emergency_stop(server.now())
        print_message("sim.stop")

    def release() -> None:
        machine.emergency = False
        print_message("sim.go")

    def switch_detector() -> None:
        machine.slave.async_detector = not machine.slave.async_detector
        print_message("sim.detector.on" if machine.slave.async_detector else "sim.detector.off")

    return {"reset": reset, "stop": press, "go": release, "detector": switch_detector, "quit": _quit}


class _TypedCommands:
    def __init__(
        self, actions: dict[str, Callable[[], None]], print_message: Callable[[str], None], attended: bool
    ) -> None:
        self._actions = actions
        self._print_message = print_message
        self._attended = attended
        self._rest = b""
        self.watched = [0] if can_poll_stdin() else []

    def read_commands(self, descriptor: int) -> None:
        data = os.read(descriptor, 1024)
        if not data:
            self.watched.remove(descriptor)
            if self._attended:
                _quit()
        *lines, self._rest = (self._rest + data)[-1024:].split(b"\n")
        for line in lines:
            self._run_command(line.decode(errors="replace").strip().casefold())

    def _run_command(self, word: str) -> None:
        found = [action for name, action in self._actions.items() if word and name.startswith(word)]
        if len(found) == 1:
            found[0]()
        elif word:
            self._print_message("sim.commands")


def _scenario_introduction(scenario: Scenario) -> str:
    client = scenario.client
    lines = [f"scenario: {scenario.title}", *textwrap.wrap(scenario.story, _WIDTH)]
    session = _SESSION_TEXTS[client.session].format(client.mode)
    occurs = f"To see what happens, connect a client that {session} over {client.over.upper()}."
    cause = f" `diagnose` then reports the root cause {scenario.shows}." if scenario.shows else ""
    return "\n  ".join(map(printable, [*lines, f"{occurs}{cause}"]))
