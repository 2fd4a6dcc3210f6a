"""Poses relative to each other, tools, works and pallets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.simulator.argument_values import bstr, float_array, i4, variant_array
from bcapscope.simulator.kinematics import moved_in_base, moved_in_tool, relative_to, rotation
from tests.simulator.simulation import Operator, Simulation, ints

numbers = st.floats(-500, 500)
angles = st.floats(-80, 80)
poses = st.tuples(numbers, numbers, numbers, angles, angles, angles)


def _same(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Compare places, and rotations whatever angles say them."""
    turns = zip(rotation(one), rotation(other), strict=True)
    return one[:3] == pytest.approx(other[:3], abs=1e-6) and all(
        a == pytest.approx(b, abs=1e-9) for a, b in turns
    )


@given(poses, poses)
def test_a_frame_undoes_what_moving_in_it_does(frame: tuple[float, ...], pose: tuple[float, ...]) -> None:
    assert _same(relative_to(frame, moved_in_tool(frame, pose)), pose)


@given(poses, poses, poses)
def test_moving_in_the_tool_is_associative(
    a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]
) -> None:
    assert _same(moved_in_tool(moved_in_tool(a, b), c), moved_in_tool(a, moved_in_tool(b, c)))


@given(poses, numbers, numbers, numbers)
def test_a_shift_keeps_the_angles(pose: tuple[float, ...], x: float, y: float, z: float) -> None:
    shift = (x, y, z, 0.0, 0.0, 0.0)
    assert moved_in_base(pose, shift) == (pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:])
    assert moved_in_tool(pose, shift)[3:] == pose[3:]


def test_a_shift_in_the_tool_goes_along_its_axes() -> None:
    down = (400.0, 0.0, 500.0, 180.0, 0.0, 0.0)
    assert moved_in_tool(down, (0, 0, 30, 0, 0, 0))[:3] == pytest.approx((400, 0, 470))
    assert moved_in_tool((0, 0, 0, 0, 0, 90), (10, 0, 0, 0, 0, 0))[:3] == pytest.approx((0, 10, 0))


def test_a_turn_in_the_base_does_not_shift() -> None:
    assert moved_in_base((1, 2, 3, 0, 0, 0), (0, 0, 0, 0, 0, 90)) == pytest.approx((1, 2, 3, 0, 0, 90))


# commands


@pytest.mark.parametrize(
    "parameter",
    [
        Variant.array(VT.BSTR, ("P(400, 0, 500, 180, 0, 90, 5)", "P(10, 0, -5, 0, 0, 0)")),
        variant_array(
            variant_array(ints(400, 0, 500, 180, 0, 90, 5), bstr("P")), bstr("P(10, 0, -5, 0, 0, 0, -1)")
        ),
        variant_array(
            variant_array(float_array(VT.R8, (400, 0, 500, 180, 0, 90, 5)), i4(0)),
            variant_array(float_array(VT.R8, (10, 0, -5, 0, 0, 0)), bstr("P")),
        ),
    ],
)
def test_dev_adds_in_the_base_and_keeps_fig(parameter: Variant) -> None:
    reply = Operator(Simulation()).robot("Dev", parameter)
    assert reply.value == pytest.approx((410, 0, 495, 180, 0, 90, 5))


def test_devh_feeds_slave_mode_as_the_sample_does() -> None:
    operator = Operator(Simulation())
    operator.ready()
    assert operator.move("@E J(0, 0, 90, 0, 90, 45)").hresult == 0
    here = operator.robot("CurPos").value
    assert isinstance(here, tuple)
    assert operator.slave(0x201).hresult == 0
    base = "P(" + ", ".join(map(str, here)) + ")"
    for step in range(20):
        offset = f"P({step * 0.1}, 0, 0, 0, 0, 0)"
        assert operator.robot("CheckVirtualFence", bstr(base)).value == 0
        moved = operator.robot("DevH", Variant.array(VT.BSTR, (base, offset))).value
        assert isinstance(moved, tuple)
        assert operator.point(*(float(str(each)) for each in moved)).hresult == 0
    assert operator.robot("slvGetMode").value == 0x201


@pytest.mark.parametrize("parameter", [bstr("P1"), Variant.array(VT.BSTR, ("P1", "nonsense")), i4(1)])
def test_dev_refuses_what_are_no_two_poses(parameter: Variant) -> None:
    assert Operator(Simulation()).robot("Dev", parameter).hresult == 0x80070057


def test_a_fence_is_asked_about_a_variable_and_needs_a_pose() -> None:
    operator = Operator(Simulation())
    assert operator.robot("CheckVirtualFence", bstr("P1")).value == 0
    assert operator.robot("CheckVirtualFence", bstr("P100")).hresult == 0x8002000B
    assert operator.robot("CheckVirtualFence", bstr("Q1")).hresult == 0x80070057


def test_tools_are_kept_for_those_who_have_the_arm() -> None:
    operator = Operator(Simulation())
    define = variant_array(i4(3), bstr("P(0, 0, 100, 0, 0, 90)"))
    assert operator.robot("SetToolDef", define).hresult == 0x83501024
    operator.robot("TakeArm")
    assert operator.robot("SetToolDef", define).hresult == 0
    assert operator.robot("GetToolDef", i4(3)).value == (0, 0, 100, 0, 0, 90)
    assert operator.robot("GetToolDef", i4(2)).value == (0,) * 6
    assert operator.robot("GetToolDef", i4(64)).hresult == 0x8002000B
    assert operator.robot("SetToolDef", variant_array(i4(0), bstr("P(0,0,0,0,0,0)"))).hresult == 0x8002000B


def test_a_pose_is_converted_from_one_work_to_another() -> None:
    operator = Operator(Simulation())
    operator.robot("TakeArm")
    operator.robot("SetWorkDef", variant_array(i4(1), bstr("P(100, 0, 0, 0, 0, 90)")))
    pose = bstr("P(10, 0, 0, 0, 0, 0, 5)")
    assert operator.robot("ConvertPosWork", variant_array(pose, i4(1), i4(0))).value == pytest.approx(
        (100, 10, 0, 0, 0, 90, 5)
    )
    assert operator.robot("ConvertPosWork", variant_array(pose, i4(1), i4(1))).value == pytest.approx(
        (10, 0, 0, 0, 0, 0, 5), abs=1e-9
    )


def _place(operator: Operator, number: int, layer: int = 1, rows: int = 3, columns: int = 5) -> object:
    pallet = operator.get("Controller_GetExtension", operator.controller, "Pallet")
    corners = [bstr(f"P({x}, {y}, 50, -180, 0, 180, 5)") for x in (600, 400) for y in (-100, 100)]
    parameter = variant_array(i4(rows), i4(columns), i4(20), *corners, i4(number), i4(layer))
    reply = operator.call("Extension_Execute", pallet, bstr("CalcPos"), parameter)
    return reply.value if reply.hresult == 0 else reply.hresult


def test_places_of_a_pallet_lie_between_its_corners() -> None:
    operator = Operator(Simulation())
    assert _place(operator, 1) == (600, -100, 50, -180, 0, 180, 5)
    assert _place(operator, 5) == (600, 100, 50, -180, 0, 180, 5)
    assert _place(operator, 8) == (500, 0, 50, -180, 0, 180, 5)
    assert _place(operator, 15, layer=3) == (400, 100, 90, -180, 0, 180, 5)
    assert _place(operator, 16) == 0x8002000B
    assert _place(operator, 0) == 0x80070057
    assert _place(operator, 1, rows=0) == 0x80070057
    assert _place(operator, 1, rows=1, columns=1) == (600, -100, 50, -180, 0, 180, 5)
