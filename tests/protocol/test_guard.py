"""The guard: what a read-only proxy passes is spelled out, since a mistake here moves a robot."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.effects import Effect
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.guard import always_passes, passes_read_only, request_effect
from bcapscope.protocol.variant import EMPTY, VT, Variant

HANDLE = Variant(VT.I4, 1)


def text(value: str) -> Variant:
    return Variant(VT.BSTR, value)


def execute(command: str, parameter: Variant = EMPTY) -> list[Variant]:
    return [HANDLE, text(command), parameter]


@pytest.mark.parametrize(
    ("function_id", "arguments", "effect"),
    [
        (64, execute("CurJnt"), Effect.READS),
        (64, execute("CURJNT"), Effect.READS),
        (64, execute("slvMove"), Effect.MOVES),
        (64, execute("TakeArm"), Effect.CHANGES),
        (64, execute("FlyToTheMoon"), Effect.MOVES),
        (64, [HANDLE], Effect.MOVES),
        (64, [HANDLE, Variant(VT.I4, 3), EMPTY], Effect.MOVES),
        (17, execute("SysState"), Effect.READS),
        (17, execute("CurJnt"), Effect.MOVES),  # a robot's command is not known for a controller
        (87, execute("GetStatus"), Effect.READS),
        (41, execute("anything"), Effect.MOVES),
        (112, [HANDLE, Variant(VT.I4, 0)], Effect.MOVES),
        (6, [HANDLE, text("a.pcs"), text("")], Effect.SESSION),
        (6, [HANDLE, text("a.pcs"), text("@create=1")], Effect.CHANGES),
        (37, [HANDLE, text("a.pcs"), text("@IfNotMember,@Create=1")], Effect.CHANGES),
        (6, [HANDLE, text("a.pcs")], Effect.CHANGES),
        (101, [HANDLE], Effect.READS),
        (102, [HANDLE, Variant(VT.I4, 1)], Effect.MOVES),
        (200, [], Effect.MOVES),
    ],
)
def test_effect_of_a_request(function_id: int, arguments: list[Variant], effect: Effect) -> None:
    assert request_effect(function_id, arguments) is effect
    assert passes_read_only(function_id, arguments) is (effect <= Effect.SESSION)


@pytest.mark.parametrize(
    ("function_id", "arguments", "passes"),
    [
        (70, [HANDLE, text("")], True),
        (70, [], True),
        (2, [], True),
        (4, [HANDLE], True),
        (84, [HANDLE], True),
        (111, [HANDLE], True),
        (64, execute("slvChangeMode", Variant(VT.I2, 0)), True),
        (64, execute("SLVCHANGEMODE", Variant(VT.I4, 0)), True),
        (64, execute("slvChangeMode", text("0")), True),
        (64, execute("slvChangeMode", Variant(VT.I4, 2)), False),
        (64, execute("slvChangeMode"), False),
        (64, execute("slvChangeMode", Variant(VT.BOOL, False)), False),
        (64, [HANDLE, text("slvChangeMode")], False),
        (17, execute("slvChangeMode", Variant(VT.I4, 0)), False),
        (72, [HANDLE], False),
        (102, [HANDLE, Variant(VT.I4, 1)], False),
        (137 + 1, [], False),
    ],
)
def test_what_always_passes(function_id: int, arguments: list[Variant], passes: bool) -> None:
    assert always_passes(function_id, arguments) is passes
    if passes:
        assert passes_read_only(function_id, arguments)


def test_nothing_that_moves_always_passes_by_its_id_alone() -> None:
    passing = {function_id for function_id in FUNCTIONS if always_passes(function_id, [])}
    assert passing == {2, 4, 36, 61, 70, 84, 99, 111, 127, 137}


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
        assert effect in (Effect.READS, Effect.SESSION)
    if function_id not in FUNCTIONS:
        assert not passes_read_only(function_id, arguments)
