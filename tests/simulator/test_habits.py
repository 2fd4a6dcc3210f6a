"""Calls in the shapes that public clients send."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import EMPTY, VT, Value, Variant
from bcapscope.simulator.argument_values import bstr, float_array, i4, r4, r8, variant_array
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.machine import InitialState
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Simulator
from tests.simulator.simulation import Operator, SimulatedClient, Simulation, ints, joints

HOME = (0, 0, 90, 0, 90, 0)
TURNED = (10, 0, 90, 0, 90, 0)


@pytest.fixture
def operator() -> Operator:
    operator = Operator(Simulation())
    operator.ready()
    return operator


def _angle(operator: Operator) -> Value:
    operator.simulation.wait(1000)
    return operator.robot("CurJnt").value


# poses


def _mixed(*values: float) -> Variant:
    """Make what the Python client makes of a list of whole and other numbers."""
    return variant_array(*(i4(value) if isinstance(value, int) else r8(value) for value in values))


@pytest.mark.parametrize(
    "pose",
    [
        variant_array(ints(*TURNED), bstr("J"), bstr("@E")),
        variant_array(ints(*TURNED), bstr("@E"), bstr("J")),
        variant_array(float_array(VT.R8, TURNED), bstr("J")),
        variant_array(float_array(VT.R8, TURNED), bstr(""), bstr("@P")),
        variant_array(float_array(VT.R4, TURNED), i4(2), i4(-2)),
        variant_array(float_array(VT.R4, TURNED), i4(-1), i4(-1)),
        variant_array(_mixed(10, 0.0, 90, 0, 90.0, 0), bstr("J"), bstr("@0")),
        _mixed(10, 0.0, 90, 0, 90.0, 0),
        ints(*TURNED),
        ints(*TURNED, 0, 0),
        bstr("@E J(10, 0, 90, 0, 90, 0)"),
        variant_array(bstr("J(10, 0, 90, 0, 90, 0)"), bstr(""), bstr("@E")),
        bstr("J5"),
        variant_array(i4(5), bstr("J"), bstr("@0")),
        variant_array(i4(5), bstr("@E"), bstr("J")),
        variant_array(i4(5), bstr("J")),
        ints(5, 2, 0),
        variant_array(Variant(VT.R4, 5.0), bstr("J"), bstr("@0")),
        float_array(VT.R4, (5, 2, -2)),
    ],
)
def test_a_pose_is_taken_in_every_notation(operator: Operator, pose: Variant) -> None:
    operator.write("J5", float_array(VT.R8, TURNED))
    assert operator.call("Robot_Move", operator.arm, i4(1), pose, bstr("")).hresult == 0
    assert _angle(operator) == joints(*TURNED)


@pytest.mark.parametrize(
    ("pose", "result"),
    [
        (variant_array(i4(100), bstr("P"), bstr("@0")), 0x8002000B),
        (variant_array(i4(-1), bstr("P"), bstr("@0")), 0x8002000B),
        (variant_array(i4(1), bstr("Q"), bstr("@0")), 0x80070057),
        (variant_array(i4(1), bstr("P"), bstr("@X")), 0x80070057),
        (variant_array(i4(1), bstr("@0")), 0x80070057),
        (ints(1), 0x80070057),
        (ints(1, 2, 3, 4, 5), 0x80070057),
        (variant_array(ints(1, 2, 3), bstr("P")), 0x80070057),
        (variant_array(), 0x80070057),
        (EMPTY, 0x80070057),
    ],
)
def test_what_is_no_pose_is_refused(operator: Operator, pose: Variant, result: int) -> None:
    assert operator.call("Robot_Move", operator.arm, i4(1), pose, bstr("")).hresult == result


def _move(operator: Operator, interpolation: int, pose: Variant) -> int:
    return operator.call("Robot_Move", operator.arm, i4(interpolation), pose, bstr("")).hresult


@pytest.mark.parametrize(
    "poses",
    [
        bstr("J(5, 0, 90, 0, 90, 0), @E J(10, 0, 90, 0, 90, 0)"),
        bstr("J4,J5"),
        Variant.array(VT.BSTR, ("J4", "@E J5")),
        variant_array(
            variant_array(float_array(VT.R8, HOME), bstr("J")),
            variant_array(float_array(VT.R8, TURNED), bstr("J"), bstr("@E")),
        ),
    ],
)
def test_a_circle_goes_to_its_second_pose(operator: Operator, poses: Variant) -> None:
    operator.write("J4", float_array(VT.R8, HOME))
    operator.write("J5", float_array(VT.R8, TURNED))
    assert _move(operator, 3, poses) == 0
    assert _angle(operator) == joints(*TURNED)


def test_a_circle_needs_two_poses_within_reach_and_a_curve_its_number(operator: Operator) -> None:
    assert _move(operator, 3, bstr("J(5, 0, 90, 0, 90, 0)")) == 0x80070057
    assert _move(operator, 3, bstr("J(171, 0, 90, 0, 90, 0), J(0, 0, 90, 0, 90, 0)")) == 0x83204071
    assert _move(operator, 4, i4(1)) == 0
    assert _move(operator, 4, i4(0)) == 0x80070057
    assert _move(operator, 5, bstr("J(5, 0, 90, 0, 90, 0)")) == 0x80070057
    assert _angle(operator) == joints(*HOME)


# options


@pytest.mark.parametrize(
    "option", ["SPEED=F2", "SPEED = 20", "S=20", "speed=i2, ACCEL=50", "S = F2,NEXT", "DECEL=F2,SPEED=20"]
)
def test_a_variable_may_give_the_speed(operator: Operator, option: str) -> None:
    operator.write("F2", r4(20.0))
    operator.write("I2", i4(20))
    usual = operator.move("J(90, 0, 90, 0, 90, 0)").ms
    slow = operator.move("J(0, 0, 90, 0, 90, 0)", option)
    assert slow.hresult == 0
    if "NEXT" in option:
        operator.simulation.wait(usual * 4.9)
        assert operator.move("J(0, 0, 90, 0, 90, 0)").hresult == 0x80010004
    else:
        assert slow.ms == pytest.approx(usual * 5, rel=0.01)


@pytest.mark.parametrize(
    ("option", "result"),
    [
        ("SPEED=F100", 0x8002000B),
        ("SPEED=F3", 0x80070057),
        ("SPEED=S1", 0x80020005),
        ("SPEED=fast", 0x80020005),
        ("ACCEL=101", 0x80070057),
        ("DECEL=0", 0x80070057),
        ("TIME=1e300", 0x80070057),
    ],
)
def test_an_option_that_makes_no_sense_is_refused(operator: Operator, option: str, result: int) -> None:
    assert operator.move("J(10, 0, 90, 0, 90, 0)", option).hresult == result


# single axes


def _driven(axis: int, angle: float, kind: int = -1, passing: int = 0) -> Variant:
    """Make what DENSO's ROS driver makes of one axis."""
    return variant_array(float_array(VT.R4, (axis, angle)), i4(kind), i4(passing))


@pytest.mark.parametrize(
    "parameter",
    [
        Variant.array(VT.BSTR, ("(1,5)", "")),
        Variant.array(VT.BSTR, ("@E (1, 5)", "SPEED=50")),
        Variant.array(VT.BSTR, ("(1, 3), (1, 2.0)", "")),
        Variant.array(VT.BSTR, ("(1, 5)",)),
        bstr("(1, 5)"),
        variant_array(bstr("(1, 5)"), bstr("")),
        variant_array(variant_array(_driven(1, 5, passing=-2)), bstr("")),
        variant_array(variant_array(ints(1, 5)), bstr("")),
    ],
)
def test_axes_are_driven_by_text_and_by_values(operator: Operator, parameter: Variant) -> None:
    assert operator.robot("DriveEx", parameter).hresult == 0
    assert _angle(operator) == joints(5, 0, 90, 0, 90, 0)


def test_axes_are_driven_to_angles(operator: Operator) -> None:
    assert operator.robot("DriveAEx", Variant.array(VT.BSTR, ("(1, 7), (3, 80)", ""))).hresult == 0
    assert _angle(operator) == joints(7, 0, 80, 0, 90, 0)


def test_the_pass_before_the_axes_counts(operator: Operator) -> None:
    plain = operator.robot("DriveAEx", Variant.array(VT.BSTR, ("(1, 10)", "")))
    operator.simulation.wait(100)
    ends = operator.robot("DriveAEx", Variant.array(VT.BSTR, ("@E (1, 0)", "")))
    assert ends.ms - plain.ms == pytest.approx(24, abs=0.1)


@pytest.mark.parametrize(
    "text", ["", "(1)", "(1,2", "1,2", "(1,5),", "(7,5)", "(1,5)(2,5)", "(x,5)", "(1,5),(2)"]
)
def test_axes_that_make_no_sense_are_refused(operator: Operator, text: str) -> None:
    assert operator.robot("DriveEx", Variant.array(VT.BSTR, (text, ""))).hresult == 0x80070057
    assert _angle(operator) == joints(*HOME)


def test_the_distance_of_an_approach_may_be_a_list(operator: Operator) -> None:
    pose = variant_array(_mixed(*TURNED), bstr("J"))
    lists = variant_array(i4(1), pose, variant_array(r8(30.0), bstr(""), bstr("@P")))
    texts = variant_array(i4(1), pose, bstr("@P 30"))
    assert operator.robot("Approach", lists).hresult == 0
    there = _angle(operator)
    assert there != joints(*HOME)
    assert operator.robot("Approach", texts).hresult == 0
    assert _angle(operator) == pytest.approx(there)
    assert (
        operator.robot("Depart", variant_array(i4(2), variant_array(r8(30.0), bstr(""), bstr("@P")))).hresult
        == 0
    )


def test_motion_skip_ends_a_motion_and_the_next_one_begins(operator: Operator) -> None:
    assert operator.move("J(90, 0, 90, 0, 90, 0)", "SPEED=10, NEXT").hresult == 0
    operator.simulation.wait(100)
    assert operator.robot("MotionSkip", ints(-1, 3)).hresult == 0
    assert operator.robot("MotionComplete", ints(-1, 0)).value is True
    assert operator.move("J(0, 0, 90, 0, 90, 0)").hresult == 0


def test_the_call_that_waits_for_a_skipped_motion_succeeds() -> None:
    simulation = Simulation()
    first, second = Operator(simulation, "a"), Operator(simulation, "b")
    first.ready()
    assert first.send("Robot_Move", first.arm, i4(1), bstr("J(90,0,90,0,90,0)"), bstr("SPEED=1")) == []
    simulation.wait(100)
    outputs = second.send("Robot_Execute", second.arm, bstr("MotionSkip"), ints(-1, 0))
    assert {output.peer for output in outputs} == {"a", "b"}


# objects and parameters


def test_names_and_options_of_objects() -> None:
    person = SimulatedClient(Simulation())
    person.call("Service_Start", bstr(""))
    texts = ("", "caoProv.denso.vrc", "192.168.0.1", "Server = 192.168.0.1")
    opened = person.call("Controller_Connect", *map(bstr, texts))
    assert opened.hresult == 0
    assert isinstance(opened.value, int)
    for name, option in (("", ""), ("Gundam", "$IsIDHandle$"), ("Slave", "ID=1")):
        reply = person.call("Controller_GetRobot", i4(opened.value), bstr(name), bstr(option))
        assert reply.hresult == 0


@pytest.mark.parametrize(
    ("command", "parameter"),
    [
        ("Takearm", bstr("")),
        ("Motor", bstr("1")),
        ("Motor", i4(1)),
        ("ExtSpeed", bstr("50.0")),
        ("ExtSpeed", i4(50)),
        ("ExtSpeed", float_array(VT.R8, (50.0, 25.0, 25.0))),
        ("ExtSpeed", _mixed(50, -1, 25.0)),
        ("Givearm", bstr("")),
    ],
)
def test_parameters_as_text_and_as_other_numbers(command: str, parameter: Variant) -> None:
    operator = Operator(Simulation("rc8", InitialState(motor=False)))
    assert operator.robot(command, parameter).hresult == 0
    if command == "ExtSpeed":
        assert operator.robot("CurExtSpd").value == 50
    if command == "Motor":
        assert operator.simulation.machine.motor_is_on(operator.simulation.now)


@pytest.mark.parametrize("profile", ["rc8", "rc9", "cserver"])
def test_the_reset_is_prepared_on_robot_and_controller(profile: str) -> None:
    operator = Operator(Simulation(profile))
    assert operator.robot("ManualResetPreparation").hresult == 0
    assert operator.command("ManualResetPreparation").hresult == 0


def test_a_serial_line_opens_and_stays_empty() -> None:
    operator = Operator(Simulation())
    line = operator.get("Controller_GetExtension", operator.controller, "Comm")

    def run(command: str, number: int = 4) -> Value:
        reply = operator.call("Extension_Execute", line, bstr(command), i4(number))
        return reply.value if reply.hresult == 0 else reply.hresult

    assert run("State") == 0
    assert [run(name) for name in ("open", "State", "clear", "count", "input")] == [None, 2, None, 0, ""]
    assert run("State", 5) == 0
    assert [run("close"), run("State")] == [None, 0]
    assert run("open", 256) == run("open", -1) == 0x8002000B


def test_an_extension_that_is_not_there_is_refused() -> None:
    operator = Operator(Simulation())
    reply = operator.call("Controller_GetExtension", operator.controller, bstr("Hand9"), bstr(""))
    assert reply.hresult == 0x80000204
    names = operator.call("Controller_GetExtensionNames", operator.controller, bstr("")).value
    assert names == ("Hand0", "Comm", "Pallet")


@pytest.mark.parametrize(
    ("kind", "is_open", "is_closed"), [("Time", 0x83500189, 0x83500191), ("Move", 0x83500190, 0x83500192)]
)
def test_brackets_open_once_and_close_once(
    operator: Operator, kind: str, is_open: int, is_closed: int
) -> None:
    assert operator.robot(f"Sync{kind}End", i4(0)).hresult == is_closed
    assert operator.robot(f"Sync{kind}Start", i4(1)).hresult == 0
    assert operator.robot(f"Sync{kind}Start").hresult == is_open
    assert operator.move("@P J(10, 0, 90, 0, 90, 0)").hresult == 0
    assert operator.robot(f"Sync{kind}End", i4(0)).hresult == 0


def test_brackets_end_with_the_client_that_has_the_arm(operator: Operator) -> None:
    assert operator.robot("SyncTimeStart").hresult == 0
    assert operator.call("Service_Stop").hresult == 0
    again = Operator(operator.simulation)
    again.ready()
    assert again.robot("SyncTimeStart").hresult == 0


def test_force_control_needs_the_arm_and_a_number_from_1_to_10() -> None:
    operator = Operator(Simulation())
    assert operator.robot("ForceCtrl", ints(1, 1)).hresult == 0x83501024
    operator.ready()
    assert operator.robot("ForceCtrl", ints(1, 11)).hresult == 0x80070057
    assert operator.robot("ForceCtrl", ints(1, 10)).hresult == 0
    assert operator.robot("ForceCtrl", ints(0)).hresult == 0


def test_force_control_is_accepted_while_the_motor_is_off(operator: Operator) -> None:
    assert operator.robot("Motor", ints(0, 0)).hresult == 0
    assert operator.robot("ForceCtrl", ints(1, 10)).hresult == 0
    parameter = variant_array(i4(1), i4(0), float_array(VT.R8, (0,) * 6))
    assert operator.robot("ForceParam", parameter).hresult == 0


def test_areas_are_kept(operator: Operator) -> None:
    assert operator.robot("GetAreaEnabled", ints(3)).value is False
    assert operator.robot("SetAreaEnabled", variant_array(i4(3), Variant(VT.BOOL, True))).hresult == 0
    assert operator.robot("GetAreaEnabled", ints(3)).value is True
    assert operator.robot("GetAreaEnabled", ints(32)).hresult == 0x8002000B


# other providers


@pytest.mark.parametrize(
    "provider", ["CaoProv.Canon.N10-W02", "CaoProv.DENSO.EVP2", "CaoProv.DENSO.RC8", "x" * 1000, "\x1b[31m"]
)
@pytest.mark.parametrize("profile", ["rc8", "rc9", "cserver"])
def test_a_provider_that_is_not_simulated_is_refused_with_a_reason(profile: str, provider: str) -> None:
    reports: list[CallReport] = []
    simulation = Simulation(profile)
    simulation.simulator = Simulator(PROFILES[profile], None, 0, lambda peer, report: reports.append(report))
    person = SimulatedClient(simulation, tcp=True)
    person.call("Service_Start", bstr(""))
    texts = ("", provider, "", "Server=192.168.0.90")
    assert person.call("Controller_Connect", *map(bstr, texts)).hresult == 0x80070057
    assert [report.result.reason[:30] for report in reports] == ["", "Controller_Connect is refused:"]
    reason = reports[-1].result.reason
    assert repr(provider[:60]) in reason
    assert reason.endswith("This profile simulates CaoProv.DENSO.VRC" + "9" * (profile == "rc9"))
    assert reason.isprintable()
