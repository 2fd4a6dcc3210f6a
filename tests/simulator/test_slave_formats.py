"""What set points and their results are made of."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.simulator.argument_values import bstr, float_array, i4, variant_array
from tests.simulator.simulation import Operator, Simulation, ints
from tests.simulator.slavemode import (
    HOME,
    started,
)


@pytest.mark.parametrize(
    ("parameter", "result"),
    [
        (float_array(VT.R8, HOME), 0),
        (float_array(VT.R4, (*HOME, 0, 0)), 0),
        (float_array(VT.R8, (*HOME, 0, 0, 0x40003F)), 0),
        (float_array(VT.R8, HOME[:5]), 0x80070057),
        (float_array(VT.R8, range(10)), 0x80070057),
        (float_array(VT.R8, (float("nan"), *HOME[1:])), 0x83201405),
        (EMPTY, 0x80070057),
        (bstr("J(0,0,90,0,90,0)"), 0x80070057),
    ],
)
def test_lengths_and_types_of_set_points(parameter: Variant, result: int) -> None:
    assert started().robot("slvMove", parameter).hresult == result


def test_positions_and_trans_are_set_points_too() -> None:
    for mode, command in ((0x201, "CurPos"), (0x203, "CurTrn")):
        operator = Operator(Simulation())
        operator.ready()
        here = operator.robot(command).value
        assert isinstance(here, tuple)
        operator.slave(mode)
        reply = operator.robot("slvMove", Variant.array(VT.R8, here))
        assert reply.hresult == 0
        assert reply.value == pytest.approx(here)


def test_formats_of_rc8() -> None:
    operator = Operator(Simulation())
    operator.ready()
    assert operator.robot("slvSendFormat", i4(0x0320)).hresult == 0x80070057
    assert operator.robot("slvSendFormat", i4(0x0020)).hresult == 0
    assert operator.robot("slvRecvFormat", ints(0x0034 | 0x40 | 0x100, 1)).hresult == 0
    operator.slave(0x202)
    point = variant_array(float_array(VT.R8, HOME), i4(0x00AB0000))
    reply = operator.robot("slvMove", point)
    assert reply.hresult == 0
    assert isinstance(reply.value, tuple)
    kinds = [part.vt for part in reply.value if isinstance(part, Variant)]
    assert kinds == [VT.I4, 0x2000 | VT.R8, VT.I4, VT.I4, 0x2000 | VT.R8]
    stamp, poses, _, hand, _ = (part.value for part in reply.value if isinstance(part, Variant))
    assert stamp == operator.simulation.now // 1000
    assert isinstance(poses, tuple)
    assert len(poses) == 15
    assert hand == 0x00AB0000
    operator.slave(0)
    assert operator.read("IOB64").value == 0xAB


def test_user_io_of_rc8() -> None:
    operator = Operator(Simulation())
    operator.ready()
    operator.robot("slvSendFormat", i4(0x200))
    operator.robot("slvRecvFormat", i4(0x202))
    operator.slave(0x202)
    data = Variant.array(VT.UI1, b"\x12\x34")
    whole = variant_array(float_array(VT.R8, HOME), i4(256), i4(16), data, i4(256), i4(16))
    reply = operator.robot("slvMove", whole)
    assert isinstance(reply.value, tuple)
    assert reply.value[1] == data
    far = variant_array(float_array(VT.R8, HOME), i4(504), i4(16), data, i4(256), i4(16))
    assert operator.robot("slvMove", far).hresult == 0x80070057


def test_rc7_has_no_formats() -> None:
    assert Operator(Simulation("rc7")).robot("slvSendFormat", i4(0)).hresult == 0x80010005
