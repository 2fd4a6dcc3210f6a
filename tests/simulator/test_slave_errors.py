"""What ends slave mode, and which replies report it."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, VT
from bcapscope.simulator.argument_values import bstr, float_array, i2, i4
from bcapscope.simulator.profile import PROFILES
from tests.simulator.simulation import Operator, Simulation, ints
from tests.simulator.slavemode import (
    HOME,
    OUTSIDE,
    REFUSED,
    UNDERFLOW,
    current_errors,
    send,
    started,
)


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_slvmove_outside_slave_mode_is_a_current_error(profile: str) -> None:
    operator = Operator(Simulation(profile))
    operator.ready()
    assert current_errors(operator) == []
    assert [send(operator, 0) for _ in range(40)] == [OUTSIDE] * 40
    assert current_errors(operator) == [OUTSIDE]
    assert operator.command("GetErrorLogCount").value == 1
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0x81501025
    assert operator.command("ClearError").hresult == 0
    assert current_errors(operator) == []


@pytest.mark.parametrize(("profile", "stops"), [("rc7", True), ("rc8", False)])
def test_slvmove_outside_slave_mode_is_an_error_of_level_3(profile: str, stops: bool) -> None:
    """It ends motions and programs; the motor stays on."""
    operator = Operator(Simulation(profile))
    operator.ready()
    operator.move("J(90,0,90,0,90,0)", "NEXT")
    operator.simulation.wait(100)
    assert send(operator, 0) == OUTSIDE
    operator.simulation.wait(100)
    busy = operator.get("Robot_GetVariable", operator.arm, "@BUSY_STATUS")
    servo = operator.get("Robot_GetVariable", operator.arm, "@SERVO_ON")
    assert operator.call("Variable_GetValue", busy).value is False
    assert operator.call("Variable_GetValue", servo).value is True
    assert operator.command("ClearError").hresult == 0
    assert operator.slave(0x002).hresult == (0x80004005 if stops else 0)


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_another_mode_in_slave_mode_is_a_current_error(profile: str) -> None:
    operator = started(profile)
    assert operator.slave(0x102).hresult == REFUSED
    assert operator.robot("slvGetMode").value == 0
    assert current_errors(operator) == [REFUSED]
    assert send(operator, 0) == OUTSIDE
    assert current_errors(operator) == [OUTSIDE, REFUSED]


def test_running_empty_while_moving_ends_slave_mode() -> None:
    operator = started(mode=0x202)
    for number in range(10):
        send(operator, number * 0.2)
    operator.simulation.wait(3 * 8 + 8)
    assert [send(operator, 2) for _ in range(3)] == [UNDERFLOW, OUTSIDE, OUTSIDE]
    assert operator.robot("slvGetMode").value == 0
    assert current_errors(operator) == [OUTSIDE, UNDERFLOW]
    assert operator.slave(0x202).hresult == 0x81501025
    assert operator.command("ClearError").hresult == 0
    assert operator.slave(0x202).hresult == 0x81501003
    assert operator.robot("Motor", ints(1, 0)).hresult == 0
    assert operator.slave(0x202).hresult == 0


def test_three_points_are_24_ms_of_slack() -> None:
    for pause, result in ((23, 0), (33, UNDERFLOW)):
        operator = started(mode=0x002)
        for number in range(3):
            send(operator, 0.2 * number)
        operator.simulation.wait(pause)
        assert send(operator, 0.6) == result


def test_standing_still_without_points_is_no_error() -> None:
    operator = started()
    for _ in range(5):
        send(operator, 0)
    operator.simulation.wait(60_000)
    assert send(operator, 0) == 0


def test_robslave_stops_with_an_error_on_rc7() -> None:
    operator = started("rc7")
    for number in range(5):
        send(operator, number * 0.3)
    operator.simulation.wait(50)
    assert send(operator, 0) == UNDERFLOW
    operator.command("ClearError")
    operator.robot("Motor", i2(1))
    operator.simulation.wait(1000)
    assert operator.slave(0x002).hresult == 0x80004005
    operator.ready()
    assert operator.slave(0x002).hresult == 0


@pytest.mark.parametrize(("detector", "mode"), [(False, 0x102), (True, 0)])
def test_a_late_point_is_an_error_in_async_of_rc7_if_its_detector_is_on(detector: bool, mode: int) -> None:
    operator = started("rc7", 0x102)
    operator.simulation.machine.slave.async_detector = detector
    for number in range(3):
        send(operator, number * 0.1)
        operator.simulation.wait(8)
    operator.simulation.wait(100)
    assert operator.robot("slvGetMode").value == mode
    assert operator.machine_error() == (UNDERFLOW if detector else 0)


@pytest.mark.parametrize(
    ("points", "code"),
    [
        ([3.0], 0x84204051),
        ([0.3, 0.6, 0.3], 0x84204041),
        ([200.0], 0x83204231),
    ],
)
def test_limits_of_an_axis_end_slave_mode(points: list[float], code: int) -> None:
    operator = started(mode=0x002)
    results = []
    for point in points:
        results.append(send(operator, point))
        operator.simulation.wait(8)
    assert operator.machine_error() == code
    assert operator.robot("slvGetMode").value == 0


def test_a_set_point_beyond_its_limit_is_refused_at_once() -> None:
    operator = started()
    assert operator.point(0, 0, 90, 0, 130, 0).hresult == 0x83204235
    assert operator.point(*HOME).hresult == OUTSIDE


@pytest.mark.parametrize("command", ["ClearError", "SysState", "GetCurErrorInfo"])
def test_commands_that_slave_mode_refuses_end_it(command: str) -> None:
    operator = started()
    assert operator.command(command, i4(0)).hresult == REFUSED
    assert operator.point(*HOME).hresult == OUTSIDE
    assert current_errors(operator) == [OUTSIDE, REFUSED]


def test_a_second_client_ends_the_first_ones_slave_mode() -> None:
    operator = started()
    other = Operator(operator.simulation, "other")
    assert other.robot("TakeArm").hresult == REFUSED
    assert operator.point(*HOME).hresult == OUTSIDE


def test_a_client_that_waits_for_its_turn_hears_of_the_error() -> None:
    operator = started("rc8", 0x202)
    other = Operator(operator.simulation, "other")
    for _ in range(3):
        operator.point(*HOME)
    assert operator.send("Robot_Execute", operator.arm, bstr("slvMove"), float_array(VT.R8, HOME)) == []
    outputs = other.send("Robot_Execute", other.arm, bstr("TakeArm"), EMPTY)
    assert {output.peer: Frame(output.data).code for output in outputs} == {
        "client": REFUSED,
        "other": REFUSED,
    }


@settings(max_examples=60, deadline=None)
@given(st.sampled_from((0x002, 0x102, 0x202)), st.lists(st.tuples(st.floats(0, 40), st.floats(-0.3, 0.3))))
def test_any_pace_gives_an_answer_each_and_an_end_that_is_told(
    mode: int, steps: list[tuple[float, float]]
) -> None:
    operator = started(mode=mode)
    here, results = 0.0, []
    for pause, way in steps:
        operator.simulation.wait(pause)
        here += way
        results.append(send(operator, here))
    ended = [number for number, result in enumerate(results) if result == OUTSIDE]
    assert ended == list(range(len(results) - len(ended), len(results)))
    on = operator.robot("slvGetMode").value == mode
    assert on is (operator.machine_error() == 0)


@pytest.mark.parametrize("mode", [0x002, 0x102, 0x202])
def test_what_ended_slave_mode_is_told_once(mode: int) -> None:
    operator = started(mode=mode)
    send(operator, 0)
    operator.simulation.machine.press_emergency_stop(operator.simulation.now)
    assert [send(operator, 0) for _ in range(3)] == [0x8150101A, OUTSIDE, OUTSIDE]


def test_what_ended_slave_mode_is_not_told_after_it_was_left() -> None:
    operator = started()
    operator.simulation.machine.switch_mode(1, operator.simulation.now)
    assert operator.slave(0).hresult == 0
    assert send(operator, 0) == OUTSIDE


@pytest.mark.parametrize("clears", [False, True])
def test_an_error_while_slave_mode_is_left_is_not_answered_later(clears: bool) -> None:
    operator = started(mode=0x002)
    send(operator, 0.3)
    assert operator.send("Robot_Execute", operator.arm, bstr("slvChangeMode"), i4(0)) == []
    operator.simulation.machine.raise_error(0x84204051, operator.simulation.now)
    (output,) = operator.simulation.wait(0)
    assert Frame(output.data).code == 0
    if clears:
        assert operator.command("ClearError").hresult == 0
    assert send(operator, 0) == OUTSIDE


def test_a_cleared_error_is_not_answered_later() -> None:
    operator = started()
    other = Operator(operator.simulation, "other")
    operator.simulation.machine.raise_error(0x84204051, operator.simulation.now)
    assert other.command("ClearError").hresult == 0
    assert send(operator, 0) == OUTSIDE


def test_a_client_that_waits_is_told_and_nobody_else() -> None:
    operator = started(mode=0x202)
    for _ in range(3):
        operator.point(*HOME)
    assert operator.send("Robot_Execute", operator.arm, bstr("slvMove"), float_array(VT.R8, HOME)) == []
    operator.simulation.machine.switch_motor(False, operator.simulation.now)
    (output,) = operator.simulation.wait(0)
    assert Frame(output.data).code == 0x81501003
    assert send(operator, 0) == OUTSIDE
