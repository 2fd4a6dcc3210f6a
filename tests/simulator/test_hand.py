"""The hands: how they move in time, what they hold, and who may call them when."""

from __future__ import annotations

from math import nextafter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.simulator.argument_values import boolean, bstr, float_array, i4, r8, variant_array
from bcapscope.simulator.equipment import COBOTTA_HAND, SECOND, Hand, HandMotion
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.scenario import read_scenario
from tests.simulator.simulation import Operator, Reply, Simulation, ints

HOLDING = variant_array(i4(10), boolean(True))
"""Parameter of HandMoveH that closes with 10 N."""


def ready(object_width: float | None = None, profile: str = "rc8") -> Operator:
    operator = Operator(Simulation(profile, InitialState(motor=True, object_width=object_width)))
    operator.ready()
    return operator


def width(operator: Operator) -> float:
    value = operator.command("HandCurPos").value
    assert isinstance(value, float)
    return value


def holds(operator: Operator) -> bool:
    value = operator.command("HandHoldState").value
    assert isinstance(value, bool)
    return value


# the motion


widths = st.floats(0, 30, allow_nan=False)


@given(widths, widths, st.floats(0.8, 80), st.floats(0, 1))
def test_a_stroke_never_leaves_its_way(a: float, b: float, speed: float, part: float) -> None:
    stroke = HandMotion.plan(a, b, 0, speed, 800)
    assert stroke.at(0) == pytest.approx(a, abs=1e-9)
    assert stroke.at(stroke.ends) == b
    between = stroke.at(round(stroke.ends * part))
    assert min(a, b) - 1e-6 <= between <= max(a, b) + 1e-6
    assert abs(stroke.at(round(stroke.ends * part) + 1_000_000) - between) <= speed / 1000 + 1e-6


@given(widths, widths, st.floats(0.8, 80), st.floats(0, 1))
def test_a_stroke_is_at_a_place_when_it_reaches_it(a: float, b: float, speed: float, part: float) -> None:
    stroke = HandMotion.plan(a, b, 5, speed, 800)
    way = abs(b - a) * part
    assert abs(stroke.at(stroke.time_at_distance(way)) - a) == pytest.approx(way, abs=1e-4)


def test_a_long_stroke_takes_its_way_at_its_speed_and_two_ramps() -> None:
    stroke = HandMotion.plan(30, 0, 0, 80, 800)
    assert stroke.ends == pytest.approx((30 / 80 + 80 / 800) * SECOND, abs=2)


@given(st.lists(st.tuples(widths, st.sampled_from((0.0, 10.0)), st.integers(0, SECOND)), max_size=8), widths)
def test_fingers_never_pass_through_an_object(moves: list[tuple[float, float, int]], thing: float) -> None:
    hand, now = Hand(COBOTTA_HAND, thing or 1.0), 0
    for goal, force, wait in moves:
        hand.move(goal, 80, now, force)
        now += wait
        assert hand.width(now) >= nextafter(hand.object_width or 0, 0)
        if hand.is_gripping(now):
            assert hand.width(now) == hand.object_width


# HandMoveA and its kin


def test_a_motion_takes_its_time_and_the_width_follows() -> None:
    operator = ready()
    assert width(operator) == 30
    moved = operator.command("HandMoveA", ints(10, 100))
    assert moved.hresult == 0
    assert moved.ms == pytest.approx(20 / 80 * 1000 + 100, abs=1)
    assert width(operator) == 10
    assert operator.command("HandMoveR", variant_array(r8(5.0), i4(50))).ms > moved.ms / 4
    assert width(operator) == pytest.approx(15)


def test_next_answers_at_once_and_a_moving_hand_refuses_the_next_command() -> None:
    operator = ready()
    slow = variant_array(r8(0.0), i4(10), bstr("Next"))
    assert operator.command("HandMoveA", slow) == Reply(0, None, 0, 0.0, 0, 0)
    operator.simulation.wait(100)
    assert 28 < width(operator) < 30
    assert operator.command("HandMoveA", ints(30, 100)).hresult == 0x83500301
    operator.simulation.wait(5000)
    assert operator.command("HandMoveA", ints(30, 100)).hresult == 0


@pytest.mark.parametrize(
    ("command", "parameter", "result"),
    [
        ("HandMoveA", ints(31, 100), 0x83500314),
        ("HandMoveA", ints(10, 0), 0x83500314),
        ("HandMoveA", ints(10, 101), 0x83500314),
        ("HandMoveA", float_array(VT.R8, (float("1e300"), 100)), 0x83500314),
        ("HandMoveA", ints(10), 0x80070057),
        ("HandMoveA", EMPTY, 0x80070057),
        ("HandMoveA", bstr("wide"), 0x80020005),
        ("HandMoveR", ints(5, 100), 0x83500314),
        ("HandMoveAH", ints(40, 100, 10), 0x83500362),
        ("HandMoveRH", ints(40, 100, 10), 0x83500363),
        ("HandMoveAH", ints(10, 100, 21), 0x83500314),
        ("HandMoveH", variant_array(i4(5), boolean(True)), 0x83500314),
        ("HandMoveVH", variant_array(r8(20), boolean(True)), 0x83500314),
    ],
)
def test_what_a_hand_cannot_do_is_refused(command: str, parameter: Variant, result: int) -> None:
    operator = ready()
    assert operator.command(command, parameter).hresult == result
    assert width(operator) == 30


def test_the_hand_needs_the_motor_and_a_controller_without_trouble_but_not_the_arm() -> None:
    operator = Operator(Simulation("rc8"))
    assert operator.command("HandMoveA", ints(10, 100)).hresult == 0x81501003
    operator.robot("Motor", ints(1, 0))
    assert operator.command("HandMoveA", ints(10, 100)).hresult == 0
    operator.simulation.machine.press_emergency_stop(operator.simulation.now)
    assert operator.command("HandMoveA", ints(20, 100)).hresult == 0x8150101A


# gripping


def test_a_grip_holds_an_object_with_its_force() -> None:
    operator = ready(object_width=12.5)
    assert not holds(operator)
    assert operator.command("HandMoveH", HOLDING).hresult == 0
    assert (holds(operator), width(operator)) == (True, 12.5)
    assert operator.simulation.machine.equipment.hand.force(operator.simulation.now) == 10
    assert operator.command("HandMoveA", ints(30, 100)).hresult == 0
    assert (holds(operator), width(operator)) == (False, 30)


def test_a_grip_of_nothing_closes_and_holds_nothing() -> None:
    operator = ready()
    assert operator.command("HandMoveH", HOLDING).hresult == 0
    assert (holds(operator), width(operator)) == (False, 0)
    assert operator.command("HandMoveH", variant_array(i4(10), boolean(False))).hresult == 0
    assert width(operator) == 30


@pytest.mark.parametrize("goal", [5, 12])
def test_a_move_with_force_grips_only_what_it_meets(goal: int) -> None:
    operator = ready(object_width=10)
    assert operator.command("HandMoveAH", ints(goal, 100, 20)).hresult == 0
    assert holds(operator) is (goal < 10)
    assert width(operator) == max(goal, 10)


def test_chuck_grips_and_unchuck_releases() -> None:
    operator = ready(object_width=10)
    assert operator.command("HandChuck").hresult == 0
    assert holds(operator)
    assert operator.command("HandUnChuck").hresult == 0
    assert not holds(operator)


def test_fingers_that_meet_an_object_without_gripping_are_an_error() -> None:
    operator = ready(object_width=10)
    assert operator.command("HandMoveA", ints(0, 100)).hresult == 0x8450031C
    assert operator.machine_error() == 0x8450031C
    assert width(operator) == 10
    assert not operator.simulation.machine.motor_is_on(operator.simulation.now)
    operator.command("ClearError")
    operator.robot("Motor", ints(1, 0))
    assert operator.command("HandMoveA", ints(30, 100)).hresult == 0


def test_that_error_comes_in_time_if_nobody_waits_for_the_motion() -> None:
    operator = ready(object_width=10)
    operator.command("HandMoveA", variant_array(i4(0), i4(100), bstr("NEXT")))
    operator.simulation.wait(100)
    assert operator.machine_error() == 0
    operator.simulation.wait(1000)
    assert operator.machine_error() == 0x8450031C


def test_without_power_the_grip_is_lost() -> None:
    operator = ready(object_width=10)
    operator.command("HandMoveH", HOLDING)
    operator.robot("Motor", ints(0, 0))
    assert not holds(operator)


# stopping


def test_stop_ends_the_motion_of_another_client() -> None:
    simulation = Simulation("rc8", InitialState(motor=True))
    first, second = Operator(simulation, "a"), Operator(simulation, "b")
    assert first.send("Controller_Execute", first.controller, bstr("HandMoveA"), ints(0, 10)) == []
    simulation.wait(500)
    outputs = second.send("Controller_Execute", second.controller, bstr("HandStop"), EMPTY)
    assert {output.peer: Frame(output.data).code for output in outputs} == {"b": 0, "a": 0x835002FF}
    stopped = width(second)
    assert 0 < stopped < 30
    simulation.wait(1000)
    assert width(second) == stopped


def test_a_stop_leaves_a_grip_and_switches_the_vacuum_off() -> None:
    operator = ready(object_width=10)
    operator.command("HandMoveH", HOLDING)
    operator.command("HandMoveVH", variant_array(r8(60.0), boolean(True)))
    assert operator.command("HandCurPressure").value == -30
    assert operator.command("HandStop").hresult == 0
    assert holds(operator)
    assert operator.command("HandCurPressure").value == 0
    assert operator.command("HandCurLoad").value == 0


def test_halt_stops_the_hand_too() -> None:
    simulation = Simulation("rc8", InitialState(motor=True))
    first, second = Operator(simulation, "a"), Operator(simulation, "b")
    first.send("Controller_Execute", first.controller, bstr("HandMoveA"), ints(0, 10))
    outputs = second.send("Robot_Halt", second.arm, bstr(""))
    assert {output.peer: Frame(output.data).code for output in outputs} == {"b": 0, "a": 0x835002FF}


# slave mode


def test_a_second_client_moves_the_hand_while_the_first_is_in_slave_mode() -> None:
    simulation = Simulation("rc8")
    first, second = Operator(simulation, "a"), Operator(simulation, "b", tcp=True)
    first.ready()
    assert first.slave(0x202).hresult == 0
    for command, parameter in (
        ("HandMoveA", ints(1, 100)),
        ("HandMoveA", ints(29, 100)),
        ("HandMoveR", ints(-5, 100)),
        ("HandMoveAH", ints(10, 100, 10)),
        ("HandMoveRH", ints(-5, 100, 10)),
        ("HandMoveH", HOLDING),
        ("HandStop", EMPTY),
        ("HandHoldState", EMPTY),
    ):
        assert second.command(command, parameter).hresult == 0
        assert first.point(0, 0, 90, 0, 90, 0, 0, 0).hresult == 0
    hand = second.get("Controller_GetExtension", second.controller, "Hand0")
    for command in ("UnChuck", "Chuck", "CurPos"):
        assert second.call("Extension_Execute", hand, bstr(command), EMPTY).hresult == 0
    assert first.robot("slvGetMode").value == 0x202


def test_the_client_in_slave_mode_may_stop_the_hand_but_not_move_it() -> None:
    operator = Operator(Simulation("rc8"))
    operator.ready()
    assert operator.slave(0x202).hresult == 0
    assert operator.command("HandStop").hresult == 0
    assert operator.command("HandHoldState").hresult == 0
    assert operator.command("HandMoveA", ints(10, 100)).hresult == 0x83501032
    assert operator.robot("slvGetMode").value == 0


# the extension and the 2FG hand


def test_the_extension_is_the_same_hand() -> None:
    operator = ready(object_width=10)
    hand = operator.get("Controller_GetExtension", operator.controller, "Hand0")
    assert operator.call("Extension_Execute", hand, bstr("CurPos"), EMPTY).value == 30
    assert operator.call("Extension_Execute", hand, bstr("Chuck"), i4(0)).hresult == 0
    assert operator.call("Extension_Execute", hand, bstr("curpos"), EMPTY).value == 10
    assert holds(operator)
    assert operator.call("Extension_Execute", hand, bstr("UnChuck"), i4(1)).hresult == 0
    assert operator.call("Extension_Execute", hand, bstr("count"), i4(1)).hresult == 0x80010005


def test_a_two_finger_grip_that_waits_tells_whether_it_found_something() -> None:
    for thing, result in ((None, 0x8350048F), (10.0, 0)):
        operator = ready(thing, "rc9")
        assert operator.robot("TwofgGrip", variant_array(r8(5), i4(20), i4(50), i4(1))).hresult == result
        assert operator.robot("TwofgIsGrip").value == int(thing is not None)
        assert operator.robot("TwofgGetWidth").value == (thing or 5)


def test_a_two_finger_grip_that_does_not_wait_is_busy_until_it_ends() -> None:
    operator = ready(10, "rc9")
    assert operator.robot("TwofgGrip", variant_array(r8(5), i4(20), i4(10), i4(0))).ms == 0
    assert operator.robot("TwofgIsBusy").value == 1
    operator.simulation.wait(5000)
    assert operator.robot("TwofgIsBusy").value == 0
    assert operator.robot("TwofgGetForce").value == 20
    assert operator.robot("HandRelease").hresult == 0
    operator.simulation.wait(5000)
    assert operator.robot("TwofgIsGrip").value == 0


def test_a_scenario_puts_an_object_between_the_fingers() -> None:
    played = read_scenario("title: t\nstart: {motor: true, object_width: 12}\n")
    assert played.initial_state().object_width == 12
