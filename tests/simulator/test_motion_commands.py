"""Motions: what they need, how long they take, and what stops them."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT
from bcapscope.simulator.argument_values import bstr, float_array, i4, r8
from tests.simulator.simulation import Operator, Simulation, ints, joints

E_INVALIDARG = 0x80070057


@pytest.mark.parametrize(
    ("option", "ms"),
    [
        ("", 274),
        ("SPEED=50", 524),
        ("speed = 50 NEXT", 0),
        ("TIME=3000", 3024),
        ("TIME=1", 274),
        ("NEXT", 0),
    ],
)
def test_a_motion_is_made_as_its_option_says(option: str, ms: float) -> None:
    operator = Operator(Simulation())
    operator.ready()
    reply = operator.move("@E J(40,0,90,0,90,0)", option)
    assert (reply.hresult, reply.ms) == (0, ms)


@pytest.mark.parametrize("option", ["SPEED=0", "SPEED=101", "SPEED=x", "TIME=-1", "TIME=1e300", "TIME=nan"])
def test_a_motion_with_an_odd_option_is_refused(option: str) -> None:
    operator = Operator(Simulation())
    operator.ready()
    assert operator.move("@E J(40,0,90,0,90,0)", option).hresult >> 16 in (0x8007, 0x8002)
    assert operator.robot("CurJnt").value == joints(0, 0, 90, 0, 90, 0)


def test_the_arm_has_one_owner() -> None:
    simulation = Simulation()
    first, second = Operator(simulation, "a"), Operator(simulation, "b")
    assert first.robot("TakeArm").hresult == 0
    assert second.robot("takearm").hresult == 0x83501024
    assert second.robot("GiveArm").hresult == 0
    assert second.robot("TakeArm").hresult == 0x83501024
    first.call("Service_Stop")
    assert second.robot("TakeArm").hresult == 0


def test_motion_needs_arm_motor_and_no_error() -> None:
    operator = Operator(Simulation())
    results = [operator.move("J(0,0,90)").hresult]
    operator.robot("Motor", i4(1))
    results.append(operator.move("J(0,0,90,0,0,0)").hresult)
    operator.robot("TakeArm")
    results.append(operator.move("J(0,0,90,0,0,0)").hresult)
    operator.simulation.machine.raise_error(0x84204051, operator.simulation.now)
    results.append(operator.move("J(0,0,90,0,0,0)").hresult)
    assert results == [E_INVALIDARG, 0x83501024, 0, 0x81501025]


def test_a_move_takes_time_and_ends_where_it_should() -> None:
    operator = Operator(Simulation())
    operator.ready()
    plain = operator.move("J(90, 0, 90, 0, 90, 0)")
    ends = operator.move("@E J(0, 0, 90, 0, 90, 0)")
    passing = operator.move("@P J(90, 0, 90, 0, 90, 0)")
    assert ends.ms - plain.ms == pytest.approx(24, abs=0.1)
    assert 0.69 < passing.ms / plain.ms < 0.71
    operator.simulation.wait(1000)
    assert operator.robot("CurJnt").value == joints(90, 0, 90, 0, 90, 0)
    operator.robot("ExtSpeed", r8(10))
    assert operator.move("J(0, 0, 90, 0, 90, 0)").ms == pytest.approx(plain.ms * 10, rel=0.01)


def test_a_second_move_meanwhile_is_told_to_come_back() -> None:
    operator = Operator(Simulation())
    operator.ready()
    assert operator.move("J(90,0,90,0,90,0)", "SPEED=50, NEXT").ms == 0
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0x80010004
    assert operator.robot("MotionComplete", ints(0, 1)).value is False
    operator.simulation.wait(2000)
    assert operator.robot("MotionComplete", ints(0, 1)).value is True
    assert operator.move("J(0,0,90,0,90,0)").hresult == 0


def test_halt_stops_a_motion_of_another_client() -> None:
    simulation = Simulation()
    first, second = Operator(simulation, "a"), Operator(simulation, "b")
    first.ready()
    first.robot("ExtSpeed", r8(1))
    assert first.send("Robot_Move", first.arm, i4(1), bstr("J(90,0,90,0,90,0)"), bstr("")) == []
    simulation.wait(100)
    outputs = second.send("Robot_Halt", second.arm, bstr(""))
    assert {output.peer: Frame(output.data).code for output in outputs} == {"b": 0, "a": 0x83201404}
    angle = second.robot("CurJnt").value
    assert isinstance(angle, tuple)
    assert 0 < float(str(angle[0])) < 10


def test_beyond_reach_and_limits() -> None:
    operator = Operator(Simulation())
    operator.ready()
    assert operator.move("J(171,0,90,0,90,0)").hresult == 0x83204071
    assert operator.move("P(5000,0,0,0,0,0)").hresult == 0x83204232
    assert operator.robot("OutRange", bstr("J(0,140,90,0,0,0)")).value == 2
    assert operator.robot("OutRange", bstr("J(0,140,90,0,900,0)")).value == 2 + 16
    assert operator.robot("OutRange", bstr("P(5000,0,0,0,0,0)")).value == -1


def test_conversions_agree_with_each_other() -> None:
    operator = Operator(Simulation())
    here = (20.0, 30.0, 60.0, 10.0, 20.0, 30.0, 0.0, 0.0)
    position = operator.robot("J2P", float_array(VT.R8, here)).value
    assert isinstance(position, tuple)
    trans = operator.robot("P2T", float_array(VT.R8, tuple(map(float, map(str, position))))).value
    assert isinstance(trans, tuple)
    back = operator.robot("T2J", float_array(VT.R8, tuple(map(float, map(str, trans))))).value
    assert back == pytest.approx(here)


def test_the_control_log_has_a_record_each_8_ms() -> None:
    operator = Operator(Simulation())
    operator.ready()
    operator.robot("StartLog")
    moved = operator.move("J(10,0,90,0,90,0)")
    operator.robot("StopLog")
    count = operator.robot("GetLogCount").value
    assert isinstance(count, int)
    assert count == int(moved.ms / 8) + 1
    tcp = Operator(operator.simulation, "tcp", tcp=True)
    record = tcp.robot("GetLogRecord", i4(count - 1)).value
    assert isinstance(record, tuple)
    assert len(record) == 39
    assert operator.robot("GetLogRecord", i4(0)).hresult == 0x80000909
    assert operator.robot("ClearLog").hresult == 0
    assert operator.robot("GetLogCount").value == 0
