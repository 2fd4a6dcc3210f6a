"""Options of the simulator: choose a scenario, list all scenarios, list the simulated behaviours."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import click

from bcapscope.faults.document import DocumentError
from bcapscope.render.columns import align_columns
from bcapscope.render.escape import printable
from bcapscope.simulator.behaviours import read_behaviours
from bcapscope.simulator.scenario import ClientProgram, Scenario, load_scenario, read_scenario
from bcapscope.simulator.scenario_files import bundled_scenarios

_WIDTH = 98
_SESSION_TEXTS = {
    ClientProgram.CALLS: "makes a few calls",
    ClientProgram.MOTION: "moves the robot",
    ClientProgram.SLAVE: "enters slave mode 0x{:03X}",
    ClientProgram.PASSING: "enters slave mode 0x{:03X} after a motion with @P",
    ClientProgram.GRIPPER: "is in slave mode 0x{:03X} while a second client writes an output",
}


def choose_scenario(context: click.Context, param: click.Parameter, named: str | None) -> Scenario | None:
    """Return an included scenario by name, or the scenario of a YAML file."""
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


def scenario_lines() -> Iterator[str]:
    """Return a table of the included scenarios, with the rule that each scenario demonstrates."""
    scenarios = ((name, read_scenario(text)) for name, text in bundled_scenarios().items())
    rows = [(name, scenario.shows or "", scenario.title) for name, scenario in scenarios]
    return align_columns([("NAME", "ROOT CAUSE", "WHAT IT SHOWS"), *rows], "<<<")


def behaviour_lines() -> Iterator[str]:
    """Return a table of the simulated behaviours, with their sources."""
    head = ("BEHAVIOUR", "CERTAINTY", "WHAT THE SIMULATOR DOES, OR WHEN IT RETURNS THE RESULT", "SOURCE")
    rows = [(each.name, each.certainty, each.text, each.source) for each in read_behaviours()]
    return align_columns([head, *rows], "<<<<")


def scenario_introduction(scenario: Scenario) -> str:
    client = scenario.client
    lines = [f"scenario: {scenario.title}", *textwrap.wrap(scenario.story, _WIDTH)]
    session = _SESSION_TEXTS[client.session].format(client.mode)
    occurs = f"To see what happens, connect a client that {session} over {client.over.upper()}."
    cause = f" `diagnose` then reports the root cause {scenario.shows}." if scenario.shows else ""
    return "\n  ".join(map(printable, [*lines, f"{occurs}{cause}"]))
