"""Motions that are held and go on."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.simulator.argument_values import bstr, i4
from bcapscope.simulator.arm import ENCODER_LAG_NS, NEVER, PASS_SHARE, Arm, TimedMove
from bcapscope.simulator.kinematics import HOME
from bcapscope.simulator.pose_notation import END_OF_ENCODERS, PASSING
from bcapscope.simulator.simulator import SimulatorOutput
from tests.simulator.simulation import MS, Operator, Reply, Simulation, ints, joints

GOAL = (40.0, *HOME[1:])
BUSY, IS_STOPPING, RUNNING = 0x80010004, 0x83201404, 0x8150100D


@pytest.mark.parametrize(
    ("passing", "part", "more"),
    [(0, 1.0, 0), (END_OF_ENCODERS, 1.0, ENCODER_LAG_NS), (PASSING, PASS_SHARE, 0)],
)
def test_when_the_next_motion_may_begin(passing: int, part: float, more: int) -> None:
    arm = Arm(HOME)
    journey = TimedMove(arm, GOAL, 5 * MS, 1.0, passing=passing)
    assert journey.done_at == 5 * MS + round((arm.ends - 5 * MS) * part) + more


def test_what_is_held_stands_and_goes_on_from_there() -> None:
    arm = Arm(HOME)
    journey = TimedMove(arm, GOAL, 0, 1.0)
    ends, half = journey.done_at, journey.done_at // 2
    journey.hold(half)
    assert (journey.is_held, journey.done_at) == (True, NEVER)
    assert arm.commanded(half) == arm.commanded(ends * 5)
    journey.hold(half + 1)
    journey.resume(ends * 5)
    assert not journey.is_held
    assert journey.done_at >= ends * 5 + half - 1
    assert arm.commanded(ends * 5) == pytest.approx((20.0, *HOME[1:]))
    assert arm.commanded(journey.done_at) == GOAL


def test_what_has_arrived_is_not_held() -> None:
    arm = Arm(HOME)
    journey = TimedMove(arm, GOAL, 0, 1.0)
    journey.hold(journey.done_at)
    journey.resume(journey.done_at)
    assert journey.done_at == arm.ends < NEVER


def answer(outputs: list[SimulatorOutput]) -> int:
    """Return the result that is in what was sent to the first client; -1 for none."""
    return next((Frame(each.data).code for each in outputs if each.peer == "client"), -1)


def pair() -> tuple[Simulation, Operator, Operator]:
    """Make a client that moves the robot, and another one; the motion takes 250 ms."""
    simulation = Simulation()
    mover, other = Operator(simulation), Operator(simulation, "other")
    mover.ready()
    assert mover.send("Robot_Move", mover.arm, i4(1), bstr("J(40,0,90,0,90,0)"), bstr("")) == []
    return simulation, mover, other


def press(operator: Operator, function: str) -> Reply:
    """Call a function that has only an option."""
    return operator.call(function, operator.arm, bstr(""))


def test_the_call_of_a_motion_waits_while_it_is_held() -> None:
    simulation, _, other = pair()
    simulation.wait(100)
    assert press(other, "Robot_Hold").hresult == 0
    there = other.robot("CurJnt").value
    assert answer(simulation.wait(60_000)) == -1
    assert other.robot("MotionComplete").value is False
    assert int(str(other.command("SysState").value)) & 0x300000 == 0
    assert other.robot("CurJnt").value == there
    assert press(other, "Robot_Unhold").hresult == 0
    assert answer(simulation.wait(1_000)) == 0
    assert other.robot("CurJnt").value == joints(40, 0, 90, 0, 90, 0)


def test_nothing_else_moves_while_a_motion_is_held() -> None:
    simulation, _, other = pair()
    simulation.wait(100)
    press(other, "Robot_Hold")
    second = Operator(simulation, "second")
    simulation.machine.owner = max(simulation.machine.open_objects)
    assert second.move("J(0,0,90,0,90,0)").hresult == BUSY
    assert second.slave(2).hresult == RUNNING
    assert press(other, "Robot_Halt").hresult == 0
    assert press(other, "Robot_Unhold").hresult == 0
    assert second.move("J(0,0,90,0,90,0)").hresult == 0


def test_a_held_motion_is_stopped_by_halt_and_by_trouble() -> None:
    simulation, _, other = pair()
    simulation.wait(100)
    press(other, "Robot_Hold")
    outputs = other.send("Robot_Halt", other.arm, bstr(""))
    assert answer(outputs) == IS_STOPPING
    simulation, _, other = pair()
    simulation.wait(100)
    press(other, "Robot_Hold")
    simulation.machine.press_emergency_stop(simulation.now)
    assert answer(simulation.wait(1)) == 0x8150101A
    assert press(other, "Robot_Unhold").hresult == 0


def test_a_held_motion_does_not_go_on_while_there_is_trouble() -> None:
    simulation, _, other = pair()
    simulation.wait(100)
    press(other, "Robot_Hold")
    simulation.machine.mode = 1
    assert press(other, "Robot_Unhold").hresult == 0x81501017
    simulation.machine.mode = 3
    assert press(other, "Robot_Unhold").hresult == 0


def test_hold_without_a_motion_does_nothing() -> None:
    operator = Operator(Simulation())
    operator.ready()
    assert press(operator, "Robot_Hold").hresult == 0
    assert operator.move("@E J(40,0,90,0,90,0)").hresult == 0
    assert press(operator, "Robot_Hold").hresult == 0
    assert operator.slave(2).hresult == 0
    assert press(operator, "Robot_Hold").hresult == 0
    assert operator.robot("slvGetMode").value == 2


@pytest.mark.parametrize("function", ["Robot_Chuck", "Robot_Unchuck", "Robot_GoHome"])
def test_what_a_controller_leaves_out(function: str) -> None:
    operator = Operator(Simulation())
    arguments = () if function == "Robot_GoHome" else (bstr(""),)
    assert operator.call(function, operator.arm, *arguments).hresult == 0x80004001


@pytest.mark.parametrize(
    ("parameter", "kept"), [(EMPTY, False), (ints(0), False), (ints(0, 0), False), (ints(0, 1), True)]
)
def test_taking_the_arm_sets_speed_tool_and_work_back(parameter: Variant, kept: bool) -> None:
    operator = Operator(Simulation())
    operator.robot("TakeArm")
    assert operator.call("Robot_Change", operator.arm, bstr("Tool3")).hresult == 0
    operator.simulation.machine.speeds.internal = 50.0
    assert operator.robot("TakeArm", parameter).hresult == 0
    machine = operator.simulation.machine
    assert (machine.speeds.internal, machine.tool) == ((50.0, 3) if kept else (100.0, 0))
