"""Scenarios, clients that meet them, and the capture of what they say: in memory, under virtual time."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable

from bcapscope.capture.recording import Recording
from bcapscope.client import over_link
from bcapscope.client.session import Opener
from bcapscope.simulator.scenario import Over, Scenario
from bcapscope.simulator.server import Answerer
from bcapscope.simulator.simulator import Simulator
from bcapscope.simulator.stage import Stage
from bcapscope.transport.clock import run_virtually
from bcapscope.transport.memory import memory_pair
from tests.client.simulated import Controller
from tests.simulator.sessions import play

WAY = 0.0002
"""Seconds that a packet is on its way."""

STRAGGLERS = 0.5
"""Seconds that the capture goes on when the clients are gone."""

LONGEST = 3600.0
"""Seconds after which a session has not ended."""


def perform(scenario: Scenario, seed: int | None = None) -> bytes:
    """Let the scenario's client meet the scenario; return the capture."""

    def stage() -> Stage:
        simulator = Simulator(scenario.controller, scenario.beginning())
        return Stage(scenario, simulator, 0, seed=seed)

    return _perform(stage, scenario)


def rehearse(scenario: Scenario) -> bytes:
    """Let the scenario's client meet a controller of the same profile with which nothing is wrong."""
    return _perform(lambda: Simulator(scenario.profile.profile), scenario)


def _perform(make: Callable[[], Answerer], scenario: Scenario) -> bytes:
    file = io.BytesIO()
    recording = Recording(file)

    async def run() -> None:
        controller = Controller(make(), recording)

        def reach(name: str) -> Opener:
            near, far = memory_pair(_takes_a_while, _takes_a_while, scenario.client.over is Over.UDP)
            controller.plug(name, far)
            return over_link(near)

        async with asyncio.timeout(LONGEST):
            await play(scenario.client, scenario.profile.profile, reach)
        await asyncio.sleep(STRAGGLERS)

    run_virtually(run())
    return file.getvalue()


def _takes_a_while(_: bytes) -> tuple[float]:
    return (WAY,)
