"""The guard: what a read-only proxy passes is spelled out, since a mistake here moves a robot."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.guard import always_passes, needs_arming, passes_read_only, request_effect
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import FUNCTIONS

HANDLE = Variant(VT.I4, 1)


def text(value: str) -> Variant:
    return Variant(VT.BSTR, value)


def execute(command: str, parameter: Variant = EMPTY) -> list[Variant]:
    return [HANDLE, text(command), parameter]


@pytest.mark.parametrize(
    ("function_id", "arguments", "effect"),
    [
        (64, execute("CurJnt"), CallEffect.READS),
        (64, execute("CURJNT"), CallEffect.READS),
        (64, execute("slvMove"), CallEffect.MOVES),
        (64, execute("TakeArm"), CallEffect.ENERGISES),
        (64, execute("FlyToTheMoon"), CallEffect.MOVES),
        (64, [HANDLE], CallEffect.MOVES),
        (64, [HANDLE, Variant(VT.I4, 3), EMPTY], CallEffect.MOVES),
        (17, execute("SysState"), CallEffect.READS),
        (17, execute("CurJnt"), CallEffect.MOVES),  # a robot's command is not known for a controller
        (87, execute("GetStatus"), CallEffect.READS),
        (41, execute("anything"), CallEffect.MOVES),
        (112, [HANDLE, Variant(VT.I4, 0)], CallEffect.MOVES),
        (6, [HANDLE, text("a.pcs"), text("")], CallEffect.SESSION),
        (6, [HANDLE, text("a.pcs"), text("@create=1")], CallEffect.CHANGES),
        (37, [HANDLE, text("a.pcs"), text("@IfNotMember,@Create=1")], CallEffect.CHANGES),
        (6, [HANDLE, text("a.pcs")], CallEffect.CHANGES),
        (101, [HANDLE], CallEffect.READS),
        (102, [HANDLE, Variant(VT.I4, 1)], CallEffect.MOVES),
        (200, [], CallEffect.MOVES),
    ],
)
def test_effect_of_a_request(function_id: int, arguments: list[Variant], effect: CallEffect) -> None:
    assert request_effect(function_id, arguments) is effect
    assert passes_read_only(function_id, arguments) is (effect <= CallEffect.SESSION)


def motor(parameter: Variant = EMPTY) -> list[Variant]:
    return execute("Motor", parameter)


@pytest.mark.parametrize(
    ("function_id", "arguments", "effect"),
    [
        (64, motor(Variant(VT.I4, 1)), CallEffect.ENERGISES),
        (64, motor(Variant.array(VT.I4, (1, 0))), CallEffect.ENERGISES),
        (64, motor(text("1")), CallEffect.ENERGISES),
        (64, motor(), CallEffect.ENERGISES),
        (64, motor(Variant.array(VT.I4, ())), CallEffect.ENERGISES),
        (64, motor(Variant(VT.BOOL, False)), CallEffect.ENERGISES),
        (64, motor(Variant(VT.I4, 0))[:2], CallEffect.ENERGISES),
        (64, [*motor(Variant(VT.I4, 0)), Variant(VT.I4, 1)], CallEffect.ENERGISES),
        (64, motor(Variant(VT.I2, 0)), CallEffect.CHANGES),
        (64, motor(text("0")), CallEffect.CHANGES),
        (64, motor(Variant.array(VT.I4, (0, 1))), CallEffect.CHANGES),
        (64, motor(Variant.array(VT.VARIANT, (Variant(VT.I4, 0), Variant(VT.I4, 1)))), CallEffect.CHANGES),
        (64, execute("GIVEARM"), CallEffect.CHANGES),
        (64, execute("TakeArm", Variant.array(VT.I4, (0, 0))), CallEffect.ENERGISES),
        (64, execute("ExtSpeed", Variant(VT.R8, 0.0)), CallEffect.ENERGISES),
        (64, execute("slvChangeMode", Variant(VT.I4, 0x202)), CallEffect.ENERGISES),
        (64, execute("slvChangeMode", Variant.array(VT.I4, (0,))), CallEffect.ENERGISES),
        (64, execute("slvChangeMode", Variant(VT.I4, 0)), CallEffect.CHANGES),
        (17, execute("ManualReset"), CallEffect.ENERGISES),
        (17, execute("Motor", Variant(VT.I4, 0)), CallEffect.MOVES),
    ],
)
def test_switching_off_is_less_than_switching_on(
    function_id: int, arguments: list[Variant], effect: CallEffect
) -> None:
    assert request_effect(function_id, arguments) is effect
    stops = always_passes(function_id, arguments)
    assert needs_arming(function_id, arguments) is (effect >= CallEffect.ENERGISES)
    assert passes_read_only(function_id, arguments) is stops


@pytest.mark.parametrize(
    ("variable", "arguments", "needed"),
    [
        ("@SERVO_ON", [HANDLE, Variant(VT.BOOL, True)], True),
        ("@SERVO_ON", [HANDLE, Variant(VT.BOOL, False)], False),
        ("@servo_on", [HANDLE, Variant(VT.BOOL, False)], False),
        ("@SERVO_ON", [HANDLE, Variant(VT.BOOL, False), Variant(VT.BOOL, True)], True),
        ("@SERVO_ON", [HANDLE], True),
        ("@STOP", [HANDLE, Variant(VT.I4, 1)], False),
        ("I1", [HANDLE, Variant(VT.I4, 0)], True),
        ("", [HANDLE, Variant(VT.BOOL, False)], True),
    ],
)
def test_a_variable_is_written_by_its_name(variable: str, arguments: list[Variant], needed: bool) -> None:
    assert needs_arming(102, arguments, variable) is needed
    assert not passes_read_only(102, arguments)


@pytest.mark.parametrize(
    ("function_id", "arguments", "passes"),
    [
        (70, [HANDLE, text("")], True),
        (70, [], True),
        (71, [HANDLE, text("")], True),
        (89, [HANDLE, Variant(VT.I4, 1), text("")], True),
        (113, [HANDLE], True),
        (2, [], True),
        (4, [HANDLE], True),
        (84, [HANDLE], True),
        (111, [HANDLE], True),
        (17, execute("HandStop"), True),
        (17, execute("HANDSTOP", text("")), True),
        (17, [HANDLE, text("HandStop")], True),
        (64, execute("TwofgStop"), True),
        (64, execute("slvChangeMode", Variant(VT.I2, 0)), True),
        (64, execute("SLVCHANGEMODE", Variant(VT.I4, 0)), True),
        (64, execute("slvChangeMode", text("0")), True),
        (64, execute("slvChangeMode", Variant(VT.I4, 2)), False),
        (64, execute("slvChangeMode"), False),
        (64, execute("slvChangeMode", Variant(VT.BOOL, False)), False),
        (64, [HANDLE, text("slvChangeMode")], False),
        (64, [*execute("slvChangeMode", Variant(VT.I4, 0)), Variant(VT.I4, 0x202)], False),
        (64, [*execute("slvChangeMode", Variant(VT.I4, 0)), EMPTY], False),
        (17, [*execute("HandStop"), EMPTY], False),
        (87, execute("HandStop"), False),
        (17, execute("slvChangeMode", Variant(VT.I4, 0)), False),
        (64, execute("Motor", Variant(VT.I4, 0)), False),
        (64, execute("GiveArm"), False),
        (72, [HANDLE], False),
        (102, [HANDLE, Variant(VT.I4, 1)], False),
        (137 + 1, [], False),
    ],
)
def test_what_always_passes(function_id: int, arguments: list[Variant], passes: bool) -> None:
    assert always_passes(function_id, arguments) is passes
    if passes:
        assert passes_read_only(function_id, arguments)
        assert not needs_arming(function_id, arguments)


def test_nothing_that_moves_always_passes_by_its_id_alone() -> None:
    passing = {function_id for function_id in FUNCTIONS if always_passes(function_id, [])}
    assert passing == {2, 4, 36, 61, 70, 71, 84, 89, 99, 111, 113, 127, 137}


VALUES = st.one_of(
    st.none(),
    st.integers(-(2**31), 2**31),
    st.floats(),
    st.text(max_size=8),
    st.binary(max_size=4),
    st.booleans(),
)


@given(st.integers(-1, 300), st.lists(st.builds(Variant, st.integers(0, 30), VALUES), max_size=4))
def test_any_arguments_are_judged(function_id: int, arguments: list[Variant]) -> None:
    effect = request_effect(function_id, arguments)
    if passes_read_only(function_id, arguments) and not always_passes(function_id, arguments):
        assert effect in (CallEffect.READS, CallEffect.SESSION)
    if function_id not in FUNCTIONS:
        assert not passes_read_only(function_id, arguments)
