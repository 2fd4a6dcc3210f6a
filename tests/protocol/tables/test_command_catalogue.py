"""The command catalogue against what the sources print."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.variant import VT, Variant, vt_name
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import (
    CommandSpec,
    command_name,
    command_parameter,
    commands_of,
    find_command,
    similar_command,
)

OWNERS = (17, 28, 64, 87)
ALL = [entry for owner in OWNERS for entry in commands_of(owner)]
TYPE_NAMES = {vt_name(vt | flag) for vt in VT for flag in (0, 0x2000)} | {"none"}


@pytest.mark.parametrize("spelling", ["slvMove", "SLVMOVE", "slvmove", "SlvMove"])
def test_names_are_matched_in_any_case(spelling: str) -> None:
    # DENSO's slides of 2009 send both SLVMOVE and slvMove.
    found = find_command(64, spelling)
    assert found is not None
    assert found.name == "slvMove"


def test_the_owner_matters() -> None:
    robot, extension = find_command(64, "CurPos"), find_command(28, "CurPos")
    assert robot is not None
    assert extension is not None
    assert robot.returns != extension.returns
    assert find_command(17, "slvMove") is None
    assert find_command(70, "slvMove") is None
    assert commands_of(70) == ()


@pytest.mark.parametrize(
    ("owner", "name", "parameter", "result", "effect"),
    [
        (64, "slvChangeMode", "VT_I2", "none", CallEffect.ENERGISES),
        (64, "slvGetMode", "VT_BSTR", "VT_I2", CallEffect.READS),
        (64, "slvMove", "VT_R4|VT_ARRAY", "VT_R4|VT_ARRAY", CallEffect.MOVES),
        (64, "slvMove", "VT_VARIANT|VT_ARRAY", "VT_R8|VT_ARRAY", CallEffect.MOVES),
        (64, "TakeArm", "VT_I4|VT_ARRAY", "VT_EMPTY", CallEffect.ENERGISES),
        (64, "Motor", "VT_I4|VT_ARRAY", "VT_EMPTY", CallEffect.ENERGISES),
        (64, "Approach", "VT_VARIANT|VT_ARRAY", "VT_EMPTY", CallEffect.MOVES),
        (64, "J2P", "VT_BSTR", "VT_R8|VT_ARRAY", CallEffect.READS),
        (64, "GetLogRecord", "VT_I4", "VT_VARIANT|VT_ARRAY", CallEffect.READS),
        (17, "ClearError", "VT_EMPTY", "VT_EMPTY", CallEffect.CHANGES),
        (17, "GetErrorDescription", "VT_I4", "VT_BSTR", CallEffect.READS),
        (17, "PutAutoMode", "VT_I2", "VT_EMPTY", CallEffect.ENERGISES),
        (17, "HandMoveA", "VT_VARIANT|VT_ARRAY", "VT_EMPTY", CallEffect.MOVES),
        (87, "GetStatus", "VT_EMPTY", "VT_I4", CallEffect.READS),
        (28, "Chuck", "VT_EMPTY", "VT_EMPTY", CallEffect.MOVES),
    ],
)
def test_types_and_effects(owner: int, name: str, parameter: str, result: str, effect: CallEffect) -> None:
    found = find_command(owner, name)
    assert found is not None
    assert parameter in found.parameter_types
    assert result in found.result_types
    assert found.effect is effect


@pytest.mark.parametrize(
    ("owner", "name", "accepted"),
    [
        (64, "slvGetMode", True),
        (64, "CurPos", True),
        (64, "CurJnt", True),
        (64, "slvRecvFormat", True),
        (64, "GetSrvData", True),
        (17, "ManualReset", True),
        (17, "ClearError", False),
        (64, "TakeArm", False),
        (17, "SysState", False),
        (17, "GetCurErrorCount", False),
        (17, "GetCurErrorInfo", False),
        (17, "GetErrorDescription", False),
        (64, "slvSendFormat", None),
        (64, "Motor", None),
    ],
)
def test_acceptance_in_slave_mode(owner: int, name: str, accepted: bool | None) -> None:
    found = find_command(owner, name)
    assert found is not None
    assert found.in_slave_mode is accepted


@pytest.mark.parametrize(
    ("function_id", "values", "name"),
    [
        (64, (1, "CurJnt"), "CurJnt"),
        (64, (1, "slvmove", 0), "slvmove"),
        (64, (1, 2, 3), None),
        (64, (1,), None),
        (64, (), None),
        (70, (1, "CurJnt"), None),
    ],
)
def test_the_command_is_the_second_argument_of_an_execute_call(
    function_id: int, values: tuple[int | str, ...], name: str | None
) -> None:
    arguments = [Variant(VT.BSTR if isinstance(value, str) else VT.I4, value) for value in values]
    assert command_name(function_id, arguments) == name


@pytest.mark.parametrize(("count", "value"), [(0, None), (2, None), (3, 2), (4, 2)])
def test_the_parameter_is_the_third_argument(count: int, value: int | None) -> None:
    found = command_parameter([Variant(VT.I4, number) for number in range(count)])
    assert found == (None if value is None else Variant(VT.I4, value))


@pytest.mark.parametrize("entry", ALL, ids=lambda entry: f"{entry.function_id}-{entry.name}")
def test_every_entry_is_sound(entry: CommandSpec) -> None:
    assert find_command(entry.function_id, entry.name.upper()) is entry
    assert set(entry.parameter_types) | set(entry.result_types) <= TYPE_NAMES
    assert entry.parameter_types
    assert entry.text
    assert not entry.text.endswith(".")


def test_no_command_stands_twice() -> None:
    keys = [(entry.function_id, entry.name.casefold()) for entry in ALL]
    assert len(keys) == len(set(keys))
    assert len(keys) > 100


def test_what_asks_does_not_move() -> None:
    for entry in ALL:
        if entry.name.startswith(("Get", "Cur")):
            assert entry.effect is CallEffect.READS


@given(st.sampled_from(ALL), st.randoms())
def test_any_mix_of_cases_is_found(entry: CommandSpec, random: Random) -> None:
    mixed = "".join(random.choice((letter.lower(), letter.upper())) for letter in entry.name)
    assert find_command(entry.function_id, mixed) is entry


@given(st.text())
def test_any_text_may_be_asked_for(name: str) -> None:
    found = find_command(64, name)
    assert found is None or found.name.casefold() == name.casefold()


@pytest.mark.parametrize(
    ("name", "similar"),
    [
        ("slvChangeMdoe", "slvChangeMode"),
        ("SLVMOV", "slvMove"),
        ("slvMove", "slvMove"),
        ("slvMove" + "x" * 60, None),
        (
            "GetMotionPreparationState" + "x" * 100,
            "GetMotionPreparationState",
        ),
        ("NobodyKnowsThis", None),
        ("", None),
    ],
)
def test_a_misspelt_command_has_a_similar_one(name: str, similar: str | None) -> None:
    assert similar_command(64, name) == similar
