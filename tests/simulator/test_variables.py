"""Variables keep what fits, and poses have the type of the generation."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.simulator.argument_values import bstr, float_array, i2, i4, r4, r8
from tests.simulator.simulation import Operator, Simulation, joints


@pytest.mark.parametrize(
    ("name", "value", "back"),
    [
        ("I7", i4(-5), -5),
        ("I7", r8(3.9), 3),
        ("F7", r8(0.5), 0.5),
        ("D7", r8(0.1), 0.1),
        ("S7", bstr("日本"), "日本"),
        ("V7", float_array(VT.R8, (1, 2, 3)), (1.0, 2.0, 3.0)),
        ("J7", float_array(VT.R4, (1, 2)), joints(1.0, 2.0)),
        ("IO130", Variant(VT.BOOL, True), True),
        ("IOB128", i2(0x7F), 0x7F),
        ("IOW128", i4(0xABCD), 0xABCD),
        ("IOF128", r4(2.5), 2.5),
    ],
)
def test_variables_keep_what_is_written(operator: Operator, name: str, value: Variant, back: object) -> None:
    assert operator.write(name, value).hresult == 0
    assert operator.read(name.lower()).value == back


@pytest.mark.parametrize(
    ("name", "value", "result"),
    [
        ("I7", bstr("5"), 0x80020005),
        ("I7", r8(1e10), 0x8002000A),
        ("I100", i4(1), 0x8002000B),
        ("P1", float_array(VT.R8, range(8)), 0x80020005),
        ("S1", bstr("x" * 248), 0x8007000E),
        ("IO512", i4(1), 0x8002000B),
        ("@MODE", i4(1), 0x8000020A),
    ],
)
def test_what_does_not_fit_is_refused(simulation: Simulation, name: str, value: Variant, result: int) -> None:
    operator = Operator(simulation, tcp=True)
    assert operator.write(name, value).hresult == result


def test_a_star_takes_its_number_from_the_id(operator: Operator) -> None:
    operator.write("I9", i4(99))
    variable = operator.get("Controller_GetVariable", operator.controller, "I*")
    assert operator.call("Variable_GetValue", variable).hresult == 0x8002000B
    operator.call("Variable_PutID", variable, i4(9))
    assert operator.call("Variable_GetValue", variable).value == 99


def test_poses_are_single_on_rc7_and_double_later() -> None:
    for name, vt in (("rc7", VT.R4), ("rc8", VT.R8)):
        operator = Operator(Simulation(name))
        variable = operator.get("Robot_GetVariable", operator.arm, "@CURRENT_ANGLE")
        reply = operator.call("Variable_GetValue", variable)
        assert (reply.vt, reply.value) == (0x2000 | vt, joints(0, 0, 90, 0, 90))


def test_the_simulator_says_that_it_is_one(operator: Operator) -> None:
    assert operator.read(SIMULATOR_VARIABLE).value == SIMULATOR_TEXT


def test_unknown_names_are_refused(operator: Operator) -> None:
    for function, name in (("GetVariable", "@NONE"), ("GetTask", "Pro9"), ("GetFile", "a.pac")):
        reply = operator.call(f"Controller_{function}", operator.controller, bstr(name), bstr(""))
        assert reply.hresult == 0x80000204
    made = operator.call("Controller_GetFile", operator.controller, bstr("a.pac"), bstr("@Create=1"))
    assert made.hresult == 0
