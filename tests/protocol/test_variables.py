"""Variables by name, as the samples and the ROS driver write them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.effects import Effect
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.variables import VARIABLES, variable, write_effect
from bcapscope.protocol.variant import EMPTY, VT, Variant

CONTROLLER, ROBOT, TASK = ObjectClass.CONTROLLER, ObjectClass.ROBOT, ObjectClass.TASK


@pytest.mark.parametrize(
    ("owner", "name", "type_", "effect"),
    [
        (CONTROLLER, "I5", "VT_I4", Effect.CHANGES),
        (CONTROLLER, "i10", "VT_I4", Effect.CHANGES),
        (CONTROLLER, "I*", "VT_I4", Effect.CHANGES),
        (CONTROLLER, "P1", "VT_R4|VT_ARRAY", Effect.CHANGES),
        (CONTROLLER, "J0", "VT_R8|VT_ARRAY", Effect.CHANGES),
        (CONTROLLER, "S12", "VT_BSTR", Effect.CHANGES),
        (CONTROLLER, "IO128", "VT_BOOL", Effect.MOVES),
        (CONTROLLER, "IOW24", "VT_I2", Effect.MOVES),
        (CONTROLLER, "@MODE", "VT_I4", Effect.CHANGES),
        (CONTROLLER, "@mode", "VT_I4", Effect.CHANGES),
        (CONTROLLER, "@VAR_S_LEN", "VT_I4", Effect.CHANGES),
        (ROBOT, "@CURRENT_ANGLE", "VT_R8|VT_ARRAY", Effect.CHANGES),
        (ROBOT, "@SERVO_ON", "VT_BOOL", Effect.ENERGISES),
        (ROBOT, "@EXTSPEED", "VT_R4", Effect.ENERGISES),
        (ROBOT, "@TYPE", "VT_I4", Effect.CHANGES),
        (TASK, "@START", "VT_I4", Effect.MOVES),
    ],
)
def test_known(owner: ObjectClass, name: str, type_: str, effect: Effect) -> None:
    kind = variable(owner, name)
    assert kind is not None
    assert type_ in kind.types
    assert kind.effect is effect


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
    assert variable(owner, name) is None


def test_inferred_types_are_marked() -> None:
    kind = variable(ROBOT, "@TYPE")
    assert kind is not None
    assert kind.inferred


def test_every_variable_is_found_by_its_name() -> None:
    for kind in VARIABLES:
        assert variable(kind.owner, kind.name.lower() + ("7" if kind.numbered else "")) is kind


@pytest.mark.parametrize(
    ("name", "value", "effect"),
    [
        ("@SERVO_ON", Variant(VT.BOOL, True), Effect.ENERGISES),
        ("@servo_on", Variant(VT.I2, -1), Effect.ENERGISES),
        ("@SERVO_ON", EMPTY, Effect.ENERGISES),
        ("@SERVO_ON", Variant(VT.R8, 0.4), Effect.ENERGISES),
        ("@SERVO_ON", Variant.array(VT.BOOL, (False,)), Effect.ENERGISES),
        ("@SERVO_ON", Variant(VT.BOOL, False), Effect.CHANGES),
        ("@Servo_On", Variant(VT.I4, 0), Effect.CHANGES),
        ("@STOP", Variant(VT.I4, 1), Effect.CHANGES),
        ("@START", Variant(VT.I4, 0), Effect.MOVES),
        ("I1", Variant(VT.I4, 0), Effect.MOVES),
        ("@SERVO_ON ", Variant(VT.BOOL, False), Effect.MOVES),
        ("", Variant(VT.BOOL, False), Effect.MOVES),
    ],
)
def test_effect_of_writing(name: str, value: Variant, effect: Effect) -> None:
    assert write_effect(name, value) is effect


@given(st.sampled_from(ObjectClass), st.text())
def test_any_name_may_be_asked_for(owner: ObjectClass, name: str) -> None:
    kind = variable(owner, name)
    assert kind is None or kind.owner is owner
