"""`bcapscope.connect`: a controller in one line, with and without asyncio."""

from __future__ import annotations

import asyncio

import pytest

import bcapscope
from bcapscope.errors import CallTimeout, ControllerError
from bcapscope.protocol.tables.function_table import FUNCTIONS

_CALLS = [
    "Service_Start",
    "Controller_Connect",
    "Controller_GetRobot",
    "Robot_Release",
    "Controller_Disconnect",
    "Service_Stop",
]


def _names(simulator: bcapscope.Simulator) -> list[str]:
    return [FUNCTIONS[call.kind.function_id].name for call in simulator.calls]


@pytest.mark.parametrize("tcp", [False, True])
def test_with(tcp: bool) -> None:
    with bcapscope.Simulator() as simulator:
        with bcapscope.connect(simulator.host, simulator.port, tcp=tcp) as (wait, controller):
            wait(controller.get_robot("Arm"))
        assert _names(simulator) == _CALLS


def test_async_with() -> None:
    async def use(simulator: bcapscope.Simulator) -> None:
        async with bcapscope.connect(simulator.host, simulator.port) as controller:
            await controller.get_robot("Arm")

    with bcapscope.Simulator() as simulator:
        asyncio.run(use(simulator))
        assert _names(simulator) == _CALLS


def test_a_refusal_ends_the_session() -> None:
    with bcapscope.Simulator() as simulator:
        with (
            pytest.raises(ControllerError),
            bcapscope.connect(simulator.host, simulator.port, provider="Wrong.Provider"),
        ):
            pass
        assert _names(simulator) == ["Service_Start", "Controller_Connect", "Service_Stop"]


def test_the_timeout_and_the_number_of_retries() -> None:
    with bcapscope.Simulator(faults=["loss=100% request"]) as simulator:
        with (
            pytest.raises(CallTimeout) as caught,
            bcapscope.connect(simulator.host, simulator.port, timeout=20, retries=2),
        ):
            pass
        assert len(caught.value.attempts) == 3
