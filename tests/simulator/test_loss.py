"""Set points over a network that loses packets, sent by clients of every convention: none is taken twice."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Value
from bcapscope.simulator.argument_values import bstr, float_array, i4
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Peer, Simulator, SimulatorOutput
from tests.simulator.simulation import MS, Operator, Simulation

TRIES, TIME_OUT = 8, 2 * MS
HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)
POINTS = 400


def reserved(convention: str, first: int, serial: int) -> int:
    """Return what a client of a convention puts into reserved."""
    if serial == first:
        return first if convention == "own" else 0
    return serial - 1 if convention == "chain" else first


class Lossy:
    """A client and a network that drops a share of the packets in each direction."""

    def __init__(
        self, simulation: Simulation, operator: Operator, convention: str, loss: float, seed: int
    ) -> None:
        self._desk = simulation
        self._arm = operator.arm
        self._convention = convention
        self._loss = loss
        self._chance = Random(seed).random
        self._serial = operator.serial

    def point(self, first: float) -> int | None:
        """Send a set point until it is answered; return the result, None for a time-out."""
        began = self._serial + 1
        for _ in range(TRIES):
            self._serial += 1
            mark = reserved(self._convention, began, self._serial)
            parts = (self._arm, bstr("slvMove"), float_array(VT.R8, (first, *HOME[1:])))
            outputs: list[SimulatorOutput] = []
            if self._chance() >= self._loss:
                raw = encode_frame(self._serial, mark, 64, parts)
                outputs = self._desk.simulator.on_datagram("client", raw, self._desk.now)
            code = self._wait(outputs)
            if code is not None:
                return code
        return None

    def _wait(self, outputs: list[SimulatorOutput]) -> int | None:
        end = self._desk.now + TIME_OUT
        while True:
            for output in outputs:
                frame = Frame(output.data)
                if self._chance() >= self._loss and frame.serial == self._serial:
                    return int(frame.code)
            due = self._desk.simulator.due(self._desk.now)
            if due is None or due > end:
                self._desk.now = end
                return None
            self._desk.now = max(due, self._desk.now + 1)
            outputs = self._desk.simulator.advance(self._desk.now)


@pytest.mark.parametrize("convention", ["seed", "own", "chain"])
@pytest.mark.parametrize("profile", ["rc7", "rc8"])
def test_no_set_point_is_taken_twice(profile: str, convention: str) -> None:
    simulation, taken = Simulation(profile), Counter[Value]()

    def count(peer: Peer, report: CallReport) -> None:
        if report.function_id == 64 and report.result.hresult == 0 and len(report.arguments) == 3:
            taken[report.arguments[2].value] += 1

    simulation.simulator = Simulator(PROFILES[profile], report=count)
    operator = Operator(simulation)
    operator.ready()
    assert operator.slave(0x002 if profile == "rc7" else 0x202).hresult == 0
    taken.clear()
    client = Lossy(simulation, operator, convention, loss=0.05, seed=7)
    results = [client.point(number * 0.001) for number in range(POINTS)]
    assert results == [0] * POINTS
    assert set(taken.values()) == {1}
    assert len(taken) == POINTS
    assert simulation.machine.slave.consumed in range(POINTS - 3, POINTS + 1)


def test_the_c_servers_defect_takes_one_twice() -> None:
    counts = []
    for name in ("rc8", "cserver"):
        simulation = Simulation(name)
        operator = Operator(simulation)
        content = (9, [operator.controller, bstr("I1"), bstr("")])
        for serial in (101, 102):  # 100 was lost
            simulation.simulator.on_datagram("client", encode_frame(serial, 100, *content), simulation.now)
        handle = Frame(
            simulation.simulator.on_datagram("client", encode_frame(200, 0, *content), simulation.now)[0].data
        ).arguments[0]
        counts.append(handle.variant)
    assert counts == [i4(4), i4(5)]
