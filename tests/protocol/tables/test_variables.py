"""Variables by name, as the samples and the ROS driver write them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.variables import VARIABLES, find_variable, write_effect

CONTROLLER, ROBOT, TASK = ObjectClass.CONTROLLER, ObjectClass.ROBOT, ObjectClass.TASK


@pytest.mark.parametrize(
    ("owner", "name", "type_"),
    [
        (CONTROLLER, "I5", "VT_I4"),
        (CONTROLLER, "i10", "VT_I4"),
        (CONTROLLER, "I*", "VT_I4"),
        (CONTROLLER, "P1", "VT_R4|VT_ARRAY"),
        (CONTROLLER, "J0", "VT_R8|VT_ARRAY"),
        (CONTROLLER, "S12", "VT_BSTR"),
        (CONTROLLER, "IO128", "VT_BOOL"),
        (CONTROLLER, "IOW24", "VT_I2"),
        (CONTROLLER, "@MODE", "VT_I4"),
        (CONTROLLER, "@mode", "VT_I4"),
        (CONTROLLER, "@VAR_S_LEN", "VT_I4"),
        (ROBOT, "@CURRENT_ANGLE", "VT_R8|VT_ARRAY"),
        (ROBOT, "@SERVO_ON", "VT_BOOL"),
        (ROBOT, "@EXTSPEED", "VT_R4"),
        (ROBOT, "@TYPE", "VT_I4"),
        (TASK, "@START", "VT_I4"),
    ],
)
def test_known(owner: ObjectClass, name: str, type_: str) -> None:
    kind = find_variable(owner, name)
    assert kind is not None
    assert type_ in kind.types


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (CONTROLLER, "I"),
        (CONTROLLER, "5"),
        (CONTROLLER, "I5x"),
        (CONTROLLER, "@START"),
        (ROBOT, "I5"),
        (TASK, ""),
    ],
)
def test_not_known(owner: ObjectClass, name: str) -> None:
    assert find_variable(owner, name) is None


def test_every_variable_is_found_by_its_name() -> None:
    for kind in VARIABLES:
        assert find_variable(kind.owner, kind.name.lower() + ("7" if kind.is_numbered else "")) is kind


@pytest.mark.parametrize(
    ("name", "value", "effect"),
    [
        ("@SERVO_ON", Variant(VT.BOOL, True), CallEffect.ENERGISES),
        ("@servo_on", Variant(VT.I2, -1), CallEffect.ENERGISES),
        ("@SERVO_ON", EMPTY, CallEffect.ENERGISES),
        ("@SERVO_ON", Variant(VT.R8, 0.4), CallEffect.ENERGISES),
        ("@SERVO_ON", Variant.array(VT.BOOL, (False,)), CallEffect.ENERGISES),
        ("@SERVO_ON", Variant(VT.BOOL, False), CallEffect.CHANGES),
        ("@Servo_On", Variant(VT.I4, 0), CallEffect.CHANGES),
        ("@STOP", Variant(VT.I4, 1), CallEffect.CHANGES),
        ("@START", Variant(VT.I4, 0), CallEffect.MOVES),
        ("I1", Variant(VT.I4, 0), CallEffect.MOVES),
        ("@SERVO_ON ", Variant(VT.BOOL, False), CallEffect.MOVES),
        ("", Variant(VT.BOOL, False), CallEffect.MOVES),
    ],
)
def test_effect_of_writing(name: str, value: Variant, effect: CallEffect) -> None:
    assert write_effect(name, value) is effect


def test_writing_a_known_variable_moves_unless_it_switches_or_stops() -> None:
    weaker = {"@SERVO_ON": CallEffect.ENERGISES, "@STOP": CallEffect.CHANGES}
    for kind in VARIABLES:
        name = f"{kind.name}7" if kind.is_numbered else kind.name
        assert write_effect(name, Variant(VT.I4, 1)) is weaker.get(kind.name, CallEffect.MOVES), name


@given(st.sampled_from(ObjectClass), st.text())
def test_any_name_may_be_asked_for(owner: ObjectClass, name: str) -> None:
    kind = find_variable(owner, name)
    assert kind is None or kind.owner is owner
