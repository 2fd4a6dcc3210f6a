"""Slave mode: how it is entered and left, and what its modes do with set points."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import EMPTY, VT
from bcapscope.simulator.argument_values import bstr, i2, i4, r8
from tests.simulator.simulation import Operator, Simulation, joints
from tests.simulator.slavemode import (
    FULL,
    HOME,
    OUTSIDE,
    OVERFLOW,
    REFUSED,
    send,
    started,
)


@pytest.mark.parametrize(
    ("profile", "mode", "result"),
    [
        ("rc7", 0x002, 0),
        ("rc7", 0x103, 0),
        ("rc7", 0x202, 0x80070057),
        ("rc8", 0x202, 0),
        ("rc9", 0x001, 0),
        ("rc8", 0x004, 0x80070057),
        ("rc8", 0x302, 0x80070057),
    ],
)
def test_modes_by_generation(profile: str, mode: int, result: int) -> None:
    operator = Operator(Simulation(profile))
    operator.ready()
    reply = operator.slave(mode)
    assert reply.hresult == result
    got = operator.robot("slvGetMode", bstr(""))
    assert got.value == (0 if result else mode)
    assert got.vt == (VT.I2 if profile == "rc7" else VT.I4)


def test_what_must_be_ready() -> None:
    operator = Operator(Simulation("rc8"))
    results = [operator.slave(0x202).hresult]
    operator.robot("Motor", i4(1))
    results.append(operator.slave(0x202).hresult)
    operator.robot("TakeArm")
    operator.simulation.machine.mode = 1
    results.append(operator.slave(0x202).hresult)
    operator.simulation.machine.mode = 3
    results.append(operator.slave(0x202).hresult)
    results.append(operator.slave(0x102).hresult)
    assert results == [0x81501003, 0x83501024, 0x81501017, 0, REFUSED]


def test_rc7_needs_robslave() -> None:
    operator = Operator(Simulation("rc7"))
    operator.robot("Motor", i2(1))
    assert operator.slave(0x002).hresult == 0x80004005
    operator.ready()
    assert operator.slave(0x002).hresult == 0


@pytest.mark.parametrize(("profile", "result"), [("rc7", 0x600B), ("rc8", 0x8150100D)])
def test_entering_waits_half_a_second_for_standstill(profile: str, result: int) -> None:
    operator = Operator(Simulation(profile))
    operator.ready()
    operator.robot("ExtSpeed", r8(10))
    operator.move("J(20,0,90,0,90,0)", "NEXT")
    reply = operator.slave(0x002)
    assert (reply.hresult, reply.ms) == (result, 500)
    operator.simulation.wait(5000)
    assert operator.slave(0x002).hresult == 0


def test_entering_after_an_end_motion_does_not_wait() -> None:
    waits = []
    for passing in ("@0", "@E"):
        operator = Operator(Simulation())
        operator.ready()
        operator.move(f"{passing} J(20,0,90,0,90,0)")
        waits.append(operator.slave(0x202).ms)
    assert waits == [24, 0]


@pytest.mark.parametrize(("profile", "mode", "at_once"), [("rc7", 0x002, 0), ("rc8", 0x202, 3)])
def test_waiting_modes_pace_the_client(profile: str, mode: int, at_once: int) -> None:
    operator = started(profile, mode)
    times = []
    for number in range(20):
        reply = operator.point(number * 0.1, *HOME[1:])
        assert reply.hresult == 0
        times.append(reply.ms)
    assert times == [0] * at_once + [8] * (20 - at_once)


def test_set_points_are_followed_with_a_lag() -> None:
    operator = started()
    for number in range(51):
        send(operator, number * 0.1)
    behind = operator.robot("CurJnt").value
    assert isinstance(behind, tuple)
    assert 4.0 < float(str(behind[0])) < 5.0
    assert operator.slave(0).hresult == 0
    assert operator.robot("CurJnt").value == pytest.approx(joints(5.0, *HOME[1:]))


def test_the_arm_does_not_move_before_a_set_point_has_come() -> None:
    operator = started("rc7")
    operator.simulation.wait(3000)
    before = operator.point(0.005, *HOME[1:]).value
    assert before == pytest.approx(joints(*HOME))


@pytest.mark.parametrize(
    ("profile", "mode", "keeps_time"),
    [
        ("rc7", 0x002, False),
        ("rc7", 0x102, True),
        ("rc8", 0x002, False),
        ("rc8", 0x102, True),
        ("rc8", 0x202, False),
    ],
)
def test_time_may_stand_still_only_where_clients_wait_for_replies(
    profile: str, mode: int, keeps_time: bool
) -> None:
    operator = started(profile, mode)
    assert operator.simulation.answerer.runs_in_real_time is keeps_time
    operator.slave(0)
    assert not operator.simulation.answerer.runs_in_real_time


def test_mode_0_warns_when_full_and_refuses_one_too_many() -> None:
    operator = started(mode=0x002)
    results = [send(operator, 0.1) for _ in range(5)]
    assert results == [0, 0, FULL, OVERFLOW, OVERFLOW]
    operator.simulation.wait(8)
    assert [send(operator, 0.1) for _ in range(2)] == [FULL, OVERFLOW]


def test_mode_1_takes_the_newest_point_and_holds_the_last() -> None:
    operator = started(mode=0x102)
    for number in range(5):
        assert send(operator, 0.05 * number) == 0
    operator.simulation.wait(100)
    assert operator.robot("CurJnt").value == pytest.approx(joints(0.2, *HOME[1:]))
    assert operator.robot("slvGetMode").value == 0x102


def test_what_slave_mode_allows() -> None:
    operator = started()
    for command in ("slvGetMode", "CurPos", "CurJnt", "GetSrvData"):
        assert operator.robot(command, i4(2)).hresult == 0
    assert operator.write("I1", i4(5)).hresult == 0
    assert operator.point(*HOME).hresult == 0
    assert operator.call("Robot_Halt", operator.arm, bstr("")).hresult == 0
    assert operator.point(*HOME).hresult == OUTSIDE


def test_the_set_points_of_another_client_are_refused() -> None:
    operator = started()
    other = Operator(operator.simulation, "other")
    assert other.point(*HOME).hresult == 0x83501024


def test_leaving_goes_to_the_last_point_first() -> None:
    operator = started(mode=0x002)
    for number in range(3):
        send(operator, number * 0.3)
    reply = operator.slave(0)
    assert (reply.hresult, reply.ms) == (0, 48)
    assert operator.machine_error() == 0
    assert operator.robot("slvMove", EMPTY).hresult == OUTSIDE
    assert operator.robot("CurJnt").value == pytest.approx(joints(0.6, *HOME[1:]))


def test_motions_after_slave_mode_begin_where_it_ended() -> None:
    operator = started()
    for number in range(20):
        send(operator, number * 0.1)
    operator.slave(0)
    assert operator.move("@E J(0,0,90,0,90,0)").hresult == 0
    assert operator.robot("CurJnt").value == joints(*HOME)


@pytest.mark.parametrize("mode", [0x002, 0x102, 0x202])
def test_slave_mode_begins_where_the_one_before_it_ended(mode: int) -> None:
    operator = started()
    for number in range(20):
        send(operator, number * 0.1)
    assert operator.slave(0).hresult == 0
    assert operator.slave(mode).hresult == 0
    assert operator.robot("CurJnt").value == pytest.approx(joints(1.9, *HOME[1:]))
    operator.simulation.wait(100)
    assert send(operator, 1.9) == 0
    operator.simulation.wait(100)
    assert operator.robot("CurJnt").value == pytest.approx(joints(1.9, *HOME[1:]))
    assert operator.machine_error() == 0
