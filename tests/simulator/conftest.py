"""A controller of each profile, and a client that has it open."""

from __future__ import annotations

import pytest

from bcapscope.simulator.profile import PROFILES
from tests.simulator.desk import Desk, Operator


@pytest.fixture(params=list(PROFILES))
def desk(request: pytest.FixtureRequest) -> Desk:
    return Desk(str(request.param))


@pytest.fixture
def operator(desk: Desk) -> Operator:
    return Operator(desk)
