"""Scenarios, clients that meet them, and the capture of what they say: in memory, under virtual time."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable

from bcapscope.capture.socket_recording import SocketRecording
from bcapscope.client.session import LinkOpener
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.scenario import Scenario, ScenarioTransport
from bcapscope.simulator.scenario_runner import ScenarioRunner
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.simulator_server import ControllerModel
from tests.client.simulated import Controller
from tests.memory_link import memory_link_pair, over_link
from tests.simulator.sessions import play
from tests.virtual_time import run_in_virtual_time

WAY = 0.0002
"""Seconds that a packet is on its way."""

STRAGGLERS = 0.5
"""Seconds that the capture goes on when the clients are gone."""

LONGEST = 3600.0
"""Seconds after which a session has not ended."""


def perform(scenario: Scenario, seed: int | None = None) -> bytes:
    """Let the scenario's client meet the scenario; return the capture."""

    def stage() -> ScenarioRunner:
        simulator = Simulator(scenario.controller_profile, scenario.initial_state())
        return ScenarioRunner(scenario, simulator, 0, seed=seed)

    return _perform(stage, scenario)


def rehearse(scenario: Scenario) -> bytes:
    """Let the scenario's client meet a controller of the same profile with which nothing is wrong."""
    return _perform(lambda: Simulator(PROFILES[scenario.profile]), scenario)


def _perform(make: Callable[[], ControllerModel], scenario: Scenario) -> bytes:
    file = io.BytesIO()
    recording = SocketRecording(file)

    async def run() -> None:
        controller = Controller(make(), recording)

        def reach(name: str) -> LinkOpener:
            near, far = memory_link_pair(
                _takes_a_while, _takes_a_while, scenario.client.over is ScenarioTransport.UDP
            )
            controller.plug(name, far)
            return over_link(near)

        async with asyncio.timeout(LONGEST):
            await play(scenario.client, PROFILES[scenario.profile], reach)
        await asyncio.sleep(STRAGGLERS)

    run_in_virtual_time(run())
    return file.getvalue()


def _takes_a_while(_: bytes) -> tuple[float]:
    return (WAY,)
