"""Every variable of the catalogue can be opened, read and written on every profile that documents it."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant, vt_name
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_REFUSED_IN_SLAVE_MODE
from bcapscope.protocol.tables.variables import VARIABLES, VariableKind
from bcapscope.simulator.argument_values import bstr, float_array, i4, r4, variant_array
from bcapscope.simulator.call_outcome import RefusalCode
from bcapscope.simulator.profile import PROFILES
from tests.simulator.simulation import Operator, Simulation

ONLY_ON_RC7 = ("TOOL", "WORK", "_ITP")
READ_ONLY = frozenset(
    (
        *("@MODE", "@ERROR_CODE", "@ERROR_DESCRIPTION", "@VERSION", "@FIRMWARE", "@CURRENT_TIME", "@LOCK"),
        *("@EMERGENCY_STOP", "@BUSY_STATUS", "@IO_ALLOC_MODE", "@NORMAL_STATUS", "@AUTO_ENABLE", "_ITP"),
        *(f"@VAR_{letter}_LEN" for letter in "IFDVPJTS"),
        *("@CURRENT_POSITION", "@CURRENT_ANGLE", "@HIGH_CURRENT_POSITION", "@HIGH_CURRENT_ANGLE"),
        *("@TYPE", "@TYPE_NAME", "@CURRENT_TOOL", "@CURRENT_WORK", "@STATUS"),
    )
)

CASES = [
    (profile, kind)
    for profile in sorted(PROFILES)
    for kind in VARIABLES
    if kind.name not in ONLY_ON_RC7 or profile == "rc7"
]


def parent_of(operator: Operator, owner: ObjectClass) -> tuple[str, Variant]:
    """Return the function that opens a variable of such an object, and the object."""
    if owner is ObjectClass.ROBOT:
        return "Robot_GetVariable", operator.arm
    if owner is ObjectClass.TASK:
        return "Task_GetVariable", operator.get("Controller_GetTask", operator.controller, "Pro1")
    return "Controller_GetVariable", operator.controller


def opened(operator: Operator, kind: VariableKind) -> Variant:
    """Open a variable; a numbered one has the number 8."""
    function, parent = parent_of(operator, kind.owner)
    return operator.get(function, parent, f"{kind.name}8" if kind.is_numbered else kind.name)


@pytest.mark.parametrize(("profile", "kind"), CASES, ids=[f"{p}-{k.owner}-{k.name}" for p, k in CASES])
def test_a_documented_variable_is_read_and_written(profile: str, kind: VariableKind) -> None:
    operator = Operator(Simulation(profile))
    variable = opened(operator, kind)
    read = operator.call("Variable_GetValue", variable)
    assert read.hresult == 0
    assert read.vt is not None
    assert read.value is not None
    if kind.types:
        assert vt_name(read.vt) in kind.types
    if read.vt & ARRAY:
        assert read.vt == ARRAY | PROFILES[profile].real
    count = len(read.value) if isinstance(read.value, tuple) else 1
    written = operator.call("Variable_PutValue", variable, Variant(read.vt, read.value, count))
    assert written.hresult == (RefusalCode.NOT_WRITABLE if kind.name in READ_ONLY else 0)


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_the_number_of_a_variable_may_follow_as_its_id(profile: str) -> None:
    operator = Operator(Simulation(profile))
    for kind in VARIABLES:
        if not kind.is_numbered or (kind.name in ONLY_ON_RC7 and profile != "rc7"):
            continue
        variable = operator.get("Controller_GetVariable", operator.controller, f"{kind.name}*")
        assert operator.call("Variable_GetValue", variable).hresult == RefusalCode.BAD_INDEX
        assert operator.call("Variable_PutID", variable, i4(8)).hresult == 0
        named = opened(operator, kind)
        assert operator.call("Variable_GetValue", variable) == operator.call("Variable_GetValue", named)
        assert operator.call("Variable_PutID", variable, i4(1000)).hresult == 0
        assert operator.call("Variable_GetValue", variable).hresult == RefusalCode.BAD_INDEX


@pytest.mark.parametrize("profile", ["rc8", "rc9", "cserver"])
@pytest.mark.parametrize("name", ["TOOL1", "WORK1", "TOOL*", "_ITP"])
def test_variables_of_rc7_are_unknown_to_later_controllers(profile: str, name: str) -> None:
    operator = Operator(Simulation(profile), tcp=True)  # the list of names is too long for a datagram
    opened = operator.call("Controller_GetVariable", operator.controller, bstr(name), bstr(""))
    assert opened.hresult == RefusalCode.OBJECT_NOT_FOUND
    listed = operator.call("Controller_GetVariableNames", operator.controller, bstr("")).value
    assert isinstance(listed, tuple)
    assert not {"TOOL0", "WORK0", "_ITP"} & set(listed)


def test_a_tool_of_rc7_is_what_its_command_defines() -> None:
    operator = Operator(Simulation("rc7"), tcp=True)
    assert operator.robot("SetToolDef", variant_array(i4(1), bstr("P(1, 2, 3, 4, 5, 6)"))).hresult == 0
    assert operator.read("TOOL1").value == (1, 2, 3, 4, 5, 6)
    assert operator.write("tool2", float_array(VT.R4, (6, 5, 4, 3, 2, 1, -1))).hresult == 0
    assert operator.robot("GetToolDef", i4(2)).value == operator.read("TOOL2").value == (6, 5, 4, 3, 2, 1)
    assert operator.read("WORK2").value == (0,) * 6
    listed = operator.call("Controller_GetVariableNames", operator.controller, bstr("")).value
    assert isinstance(listed, tuple)
    assert {"TOOL0", "WORK0", "_ITP"} <= set(listed)


@pytest.mark.parametrize(
    ("name", "value", "result"),
    [
        ("TOOL0", float_array(VT.R4, (0,) * 6), RefusalCode.BAD_INDEX),
        ("WORK64", float_array(VT.R4, (0,) * 6), RefusalCode.BAD_INDEX),
        ("TOOL1", i4(5), RefusalCode.TYPE_MISMATCH),
        ("TOOL1", bstr("P(1, 2, 3, 4, 5, 6)"), RefusalCode.TYPE_MISMATCH),
        ("WORK1", float_array(VT.R4, (0,) * 8), RefusalCode.TYPE_MISMATCH),
        ("WORK1", EMPTY, RefusalCode.TYPE_MISMATCH),
    ],
)
def test_a_frame_that_makes_no_sense_is_refused(name: str, value: Variant, result: int) -> None:
    assert Operator(Simulation("rc7")).write(name, value).hresult == result


@pytest.mark.parametrize("profile", sorted(PROFILES))
@pytest.mark.parametrize("name", ["@EXTSPEED", "@EXTACCEL", "@extdecel"])
def test_external_speeds_are_refused_in_slave_mode_as_the_command_is(profile: str, name: str) -> None:
    results = []
    for by_variable in (True, False):
        operator = Operator(Simulation(profile))
        variable = operator.get("Robot_GetVariable", operator.arm, name)
        operator.ready()
        assert operator.slave(0x002).hresult == 0
        if by_variable:
            results.append(operator.call("Variable_PutValue", variable, r4(50)).hresult)
        else:
            results.append(operator.robot("ExtSpeed", r4(50)).hresult)
        assert operator.robot("slvGetMode").value == 0
        assert operator.machine_error() == results[-1]
        assert operator.call("Variable_GetValue", variable).value == 100
    assert results == [E_REFUSED_IN_SLAVE_MODE] * 2


@pytest.mark.parametrize("name", ["@SPEED", "@ACCEL", "@JDECEL"])
def test_internal_speeds_are_accepted_in_slave_mode_as_robot_speed_is(name: str) -> None:
    operator = Operator(Simulation())
    variable = operator.get("Robot_GetVariable", operator.arm, name)
    operator.ready()
    assert operator.slave(0x202).hresult == 0
    assert operator.call("Variable_PutValue", variable, r4(50)).hresult == 0
    assert operator.call("Robot_Speed", operator.arm, i4(-1), r4(50)).hresult == 0
    assert operator.robot("slvGetMode").value == 0x202


@pytest.mark.parametrize("value", [r4(0), r4(101), r4(-1)])
def test_speeds_outside_their_range_are_not_written(value: Variant) -> None:
    operator = Operator(Simulation())
    for name in ("@SPEED", "@EXTSPEED"):
        variable = operator.get("Robot_GetVariable", operator.arm, name)
        assert operator.call("Variable_PutValue", variable, value).hresult == RefusalCode.NOT_WRITABLE
        assert operator.call("Variable_GetValue", variable).value == 100
