"""Effects of functions: which ones move the robot is a matter of safety, so it is spelled out here again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.tables.call_effect import FUNCTION_EFFECTS, CallEffect, function_effect
from bcapscope.protocol.tables.function_table import FUNCTIONS, function_by_name


@pytest.mark.parametrize(
    ("name", "effect"),
    [
        ("Robot_Move", CallEffect.MOVES),
        ("Robot_Drive", CallEffect.MOVES),
        ("Robot_GoHome", CallEffect.MOVES),
        ("Robot_Rotate", CallEffect.MOVES),
        ("Robot_Unhold", CallEffect.MOVES),
        ("Robot_Chuck", CallEffect.MOVES),
        ("Robot_Unchuck", CallEffect.MOVES),
        ("Task_Start", CallEffect.MOVES),
        ("File_Run", CallEffect.MOVES),
        ("Variable_PutValue", CallEffect.MOVES),
        ("Command_Execute", CallEffect.MOVES),
        ("Robot_Execute", CallEffect.MOVES),
        ("Robot_Speed", CallEffect.CHANGES),
        ("Robot_Halt", CallEffect.CHANGES),
        ("Task_Stop", CallEffect.CHANGES),
        ("Controller_PutTag", CallEffect.CHANGES),
        ("File_PutValue", CallEffect.CHANGES),
        ("Command_PutTimeout", CallEffect.CHANGES),
        ("Message_Reply", CallEffect.CHANGES),
        ("Service_Start", CallEffect.SESSION),
        ("Controller_Connect", CallEffect.SESSION),
        ("Robot_GetVariable", CallEffect.SESSION),
        ("Variable_Release", CallEffect.SESSION),
        ("Controller_GetMessage", CallEffect.SESSION),
        ("Variable_GetValue", CallEffect.READS),
        ("Controller_GetRobotNames", CallEffect.READS),
        ("Command_GetState", CallEffect.READS),
    ],
)
def test_effect_of(name: str, effect: CallEffect) -> None:
    function = function_by_name(name)
    assert function is not None
    assert function_effect(function.id) is effect


def test_every_function_has_an_effect() -> None:
    assert set(FUNCTION_EFFECTS) == set(FUNCTIONS)


def test_only_asking_functions_read() -> None:
    for function_id, effect in FUNCTION_EFFECTS.items():
        if effect is CallEffect.READS:
            assert "_Get" in FUNCTIONS[function_id].name


@given(st.integers().filter(lambda number: not 1 <= number <= 137))
def test_what_is_no_function_may_move(number: int) -> None:
    assert function_effect(number) is CallEffect.MOVES
