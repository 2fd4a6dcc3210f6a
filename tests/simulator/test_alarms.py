"""Errors and the emergency stop, as clients see them."""

from __future__ import annotations

from bcapscope.simulator.argument_values import i4
from tests.simulator.simulation import Operator, Simulation


def test_errors_are_told_until_they_are_cleared() -> None:
    operator = Operator(Simulation())
    operator.simulation.machine.raise_error(0x84204051, operator.simulation.now)
    assert operator.read("@ERROR_CODE").value == 0x84204051 - (1 << 32)
    assert operator.command("GetCurErrorCount").value == 1
    info = operator.command("GetCurErrorInfo", i4(0)).value
    assert isinstance(info, tuple)
    assert len(info) == 7
    assert "J1" in str(info[1])
    assert operator.command("GetCurErrorInfo", i4(1)).hresult == 0x8002000B
    state = operator.command("SysState").value
    assert isinstance(state, int)
    assert state >> 1 & 1
    assert operator.command("ClearError").hresult == 0
    assert operator.command("GetCurErrorCount").value == 0
    assert operator.command("GetErrorLogCount").value == 1
    log = operator.command("GetErrorLog", i4(0)).value
    assert isinstance(log, tuple)
    assert len(log) == 16


def test_the_emergency_stop_stays_until_it_is_let_go() -> None:
    operator = Operator(Simulation())
    operator.ready()
    operator.simulation.machine.press_emergency_stop(operator.simulation.now)
    assert operator.robot("Motor", i4(1)).hresult == 0x8150101A
    assert operator.command("ClearError").hresult == 0x8150101A
    operator.simulation.machine.emergency = False
    assert operator.command("ClearError").hresult == 0
    assert operator.robot("Motor", i4(1)).hresult == 0
