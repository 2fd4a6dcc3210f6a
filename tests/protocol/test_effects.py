"""Effects of functions: which ones move the robot is a matter of safety, so it is spelled out here again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.effects import FUNCTION_EFFECTS, Effect, function_effect
from bcapscope.protocol.functions import FUNCTIONS, function_by_name


@pytest.mark.parametrize(
    ("name", "effect"),
    [
        ("Robot_Move", Effect.MOVES),
        ("Robot_Drive", Effect.MOVES),
        ("Robot_GoHome", Effect.MOVES),
        ("Robot_Rotate", Effect.MOVES),
        ("Robot_Unhold", Effect.MOVES),
        ("Robot_Chuck", Effect.MOVES),
        ("Robot_Unchuck", Effect.MOVES),
        ("Task_Start", Effect.MOVES),
        ("File_Run", Effect.MOVES),
        ("Variable_PutValue", Effect.MOVES),
        ("Command_Execute", Effect.MOVES),
        ("Robot_Execute", Effect.MOVES),
        ("Robot_Speed", Effect.CHANGES),
        ("Robot_Halt", Effect.CHANGES),
        ("Task_Stop", Effect.CHANGES),
        ("Controller_PutTag", Effect.CHANGES),
        ("File_PutValue", Effect.CHANGES),
        ("Command_PutTimeout", Effect.CHANGES),
        ("Message_Reply", Effect.CHANGES),
        ("Service_Start", Effect.SESSION),
        ("Controller_Connect", Effect.SESSION),
        ("Robot_GetVariable", Effect.SESSION),
        ("Variable_Release", Effect.SESSION),
        ("Controller_GetMessage", Effect.SESSION),
        ("Variable_GetValue", Effect.READS),
        ("Controller_GetRobotNames", Effect.READS),
        ("Command_GetState", Effect.READS),
    ],
)
def test_effect_of(name: str, effect: Effect) -> None:
    function = function_by_name(name)
    assert function is not None
    assert function_effect(function.id) is effect


def test_every_function_has_an_effect() -> None:
    assert set(FUNCTION_EFFECTS) == set(FUNCTIONS)


def test_only_asking_functions_read() -> None:
    for function_id, effect in FUNCTION_EFFECTS.items():
        if effect is Effect.READS:
            assert "_Get" in FUNCTIONS[function_id].name


@given(st.integers().filter(lambda number: not 1 <= number <= 137))
def test_what_is_no_function_may_move(number: int) -> None:
    assert function_effect(number) is Effect.MOVES
