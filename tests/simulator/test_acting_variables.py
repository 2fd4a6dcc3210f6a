"""Variables that do what a command does when they are written: @SERVO_ON, @START, @STOP."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import PROFILES
from tests.simulator.simulation import Operator, Simulation, ints


def servo(operator: Operator) -> Variant:
    """Open the variable that shows and switches the motor."""
    return operator.get("Robot_GetVariable", operator.arm, "@servo_on")


@pytest.mark.parametrize("profile", sorted(PROFILES))
@pytest.mark.parametrize("tcp", [False, True])
def test_writing_servo_on_switches_the_motor_as_the_command_does(profile: str, tcp: bool) -> None:
    operator = Operator(Simulation(profile), tcp=tcp)
    variable = servo(operator)
    states = [operator.call("Variable_GetValue", variable).value]
    on = operator.call("Variable_PutValue", variable, Variant(VT.BOOL, True))
    states.append(operator.call("Variable_GetValue", variable).value)
    again = operator.call("Variable_PutValue", variable, Variant(VT.BOOL, True))
    off = operator.call("Variable_PutValue", variable, Variant(VT.BOOL, False))
    states.append(operator.call("Variable_GetValue", variable).value)
    assert states == [False, True, False]
    assert [(each.hresult, each.vt, each.ms) for each in (on, again, off)] == [
        (0, None, 400),
        (0, None, 0),
        (0, None, 0),
    ]


def test_a_motion_ends_when_servo_on_is_written_false() -> None:
    simulation = Simulation()
    operator, other = Operator(simulation), Operator(simulation, "other", tcp=True)
    operator.ready()
    variable = servo(other)
    pose = bstr("J(90,0,90,0,90,0)")
    assert operator.send("Robot_Move", operator.arm, i4(1), pose, bstr("")) == []
    simulation.wait(100)
    outputs = other.send("Variable_PutValue", variable, Variant(VT.BOOL, False))
    assert {output.peer: Frame(output.data).code for output in outputs} == {"other": 0, "client": 0x81501003}
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0x81501003


@pytest.mark.parametrize(
    ("start", "result"),
    [
        (InitialState(emergency=True), 0x8150101A),
        (InitialState(errors=(0x84201482,)), 0x81501025),
        (InitialState(mode=1), 0x81501017),
        (InitialState(token=False), 0x83501028),
    ],
)
def test_servo_on_is_refused_as_the_motor_command_is(start: InitialState, result: int) -> None:
    operator = Operator(Simulation("rc8", start))
    variable = servo(operator)
    written = operator.call("Variable_PutValue", variable, Variant(VT.BOOL, True))
    assert written.hresult == operator.robot("Motor", ints(1, 0)).hresult == result
    assert operator.call("Variable_GetValue", variable).value is False
    assert operator.call("Variable_PutValue", variable, Variant(VT.BOOL, False)).hresult == 0


@pytest.mark.parametrize("value", [Variant(VT.BSTR, "on"), EMPTY, Variant(VT.NULL, None)])
def test_servo_on_takes_only_what_says_on_or_off(value: Variant) -> None:
    operator = Operator(Simulation())
    variable = servo(operator)
    assert operator.call("Variable_PutValue", variable, value).hresult in (E_INVALIDARG, 0x80020005)
    assert operator.call("Variable_GetValue", variable).value is False


@pytest.mark.parametrize(("name", "value"), [("@SERVO_ON", True), ("@SERVO_ON", False), ("@START", 1)])
def test_a_variable_that_acts_is_refused_in_slave_mode_as_its_command_is(name: str, value: object) -> None:
    operator = Operator(Simulation())
    task = operator.get("Controller_GetTask", operator.controller, "Pro1")
    variable = servo(operator) if name == "@SERVO_ON" else operator.get("Task_GetVariable", task, name)
    operator.ready()
    assert operator.slave(0x202).hresult == 0
    written = operator.call("Variable_PutValue", variable, Variant(VT.BOOL, bool(value)))
    assert written.hresult == 0x83501032
    assert operator.machine_error() == 0x83501032
    assert operator.robot("slvGetMode").value == 0
    assert operator.robot("Motor", ints(1, 0)).hresult == 0x81501025


def test_writing_start_and_stop_is_starting_and_stopping_a_task() -> None:
    operator = Operator(Simulation("rc7"))
    task = operator.get("Controller_GetTask", operator.controller, "RobSlave")
    start, stop = (operator.get("Task_GetVariable", task, name) for name in ("@START", "@STOP"))
    operator.simulation.machine.press_emergency_stop(operator.simulation.now)
    assert operator.call("Variable_PutValue", start, i4(1)).hresult == 0x8150101A
    operator.simulation.machine.emergency = False
    operator.command("ClearError")
    assert operator.call("Variable_PutValue", start, i4(1)).hresult == 0
    operator.robot("Motor", i4(1))
    assert operator.slave(0x002).hresult == 0
    assert operator.slave(0).hresult == 0
    assert operator.call("Variable_PutValue", stop, i4(1)).hresult == 0
    assert operator.slave(0x002).hresult == 0x80004005


@pytest.mark.parametrize(("profile", "mode", "after"), [("rc7", 0x002, 0), ("rc8", 0x202, 0x202)])
def test_writing_stop_is_allowed_in_slave_mode_as_task_stop_is(profile: str, mode: int, after: int) -> None:
    """It stops RobSlave, without which there is no slave mode on RC7."""
    for by_variable in (True, False):
        operator = Operator(Simulation(profile))
        task = operator.get("Controller_GetTask", operator.controller, "RobSlave")
        stop = operator.get("Task_GetVariable", task, "@STOP")
        operator.ready()
        assert operator.slave(mode).hresult == 0
        if by_variable:
            assert operator.call("Variable_PutValue", stop, i4(1)).hresult == 0
        else:
            assert operator.call("Task_Stop", task, i4(1), bstr("")).hresult == 0
        assert operator.robot("slvGetMode").value == after
        assert operator.machine_error() == 0
