"""A controller of each profile, and a client that has it open."""

from __future__ import annotations

import pytest

from bcapscope.simulator.profile import PROFILES
from tests.simulator.simulation import Operator, Simulation


@pytest.fixture(params=list(PROFILES))
def simulation(request: pytest.FixtureRequest) -> Simulation:
    return Simulation(str(request.param))


@pytest.fixture
def operator(simulation: Simulation) -> Operator:
    return Operator(simulation)
