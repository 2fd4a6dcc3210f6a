"""Set up a simulated controller from a scenario, a profile and faults."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import msgspec

from bcapscope.errors import InputError
from bcapscope.faults.fault_kinds import AnyFault
from bcapscope.messages import Message
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.profile import DEFAULT_PROFILE, PROFILES, NoArgument
from bcapscope.simulator.scenario import ProfileName, Scenario, ServerDefect
from bcapscope.simulator.scenario_runner import ScenarioRunner
from bcapscope.simulator.simulator import Peer, Simulator


class ScenarioProfileError(InputError):
    """The scenario is made for another profile than the user chose."""


def played_scenario(
    scenario: Scenario | None,
    profile: str | None,
    *,
    defects: Sequence[ServerDefect] = (),
    no_argument: NoArgument | None = None,
    faults: Sequence[AnyFault] = (),
) -> Scenario:
    """Apply defects, faults and `no_argument` to a copy of `scenario`. None means a scenario without events.

    Raises:
        ScenarioProfileError: The scenario is made for a profile other than `profile`.
        InputError: No profile has the name `profile`.
    """
    if profile is not None and profile not in PROFILES:
        raise InputError(Message("simulator.unknown-profile", name=f"{profile!r}", known=", ".join(PROFILES)))
    if scenario is not None and profile not in (None, scenario.profile):
        raise ScenarioProfileError(Message("scenario.other-profile", profile=str(scenario.profile)))
    chosen = scenario or Scenario(title="", profile=ProfileName(profile or DEFAULT_PROFILE))
    return msgspec.structs.replace(
        chosen,
        defects=tuple(defects) or chosen.defects,
        no_argument=chosen.no_argument if no_argument is None else no_argument,
        faults=(*chosen.faults, *faults),
    )


def start_controller(
    played: Scenario,
    seed: int | None = None,
    *,
    on_call: Callable[[Peer, CallReport], None] = lambda peer, report: None,
    on_news: Callable[[Message], None] = lambda news: None,
) -> tuple[Simulator, Simulator | ScenarioRunner]:
    """Start a simulator in the initial state of a scenario, on the monotonic clock.

    Return the simulator, and the object to which a `SimulatorServer` passes the clients' traffic. This object
    is a `ScenarioRunner` if the scenario has faults, events or variables. Otherwise, it is the simulator.
    """
    now = time.monotonic_ns()
    start = played.initial_state(epoch=time.time_ns() - now)
    simulator = Simulator(played.controller_profile, start, now, on_call)
    if played.faults or played.in_slave_mode or played.variables:
        return simulator, ScenarioRunner(played, simulator, now, seed=seed, on_news=on_news)
    return simulator, simulator
