"""Replies without a value: one EMPTY argument, or none."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.tables.function_table import FUNCTIONS, ResultKind
from bcapscope.simulator.argument_values import bstr, i2, i4
from bcapscope.simulator.profile import PROFILES
from tests.simulator.simulation import Operator, Simulation

_RETURNING = [each for each in FUNCTIONS.values() if each.result is not ResultKind.NONE]


def simulation(profile: str, no_argument: str = "") -> Simulation:
    """Switch a controller on, with the replies of its profile or with others."""
    if not no_argument:
        return Simulation(profile)
    return Simulation.of(f"title: x\nprofile: {profile}\nno_argument: {no_argument}")


def empties(operator: Operator) -> list[int | None]:
    """Make calls that return nothing; return the types of what came back, None for no argument.

    In this order: Motor, SLVCHANGEMODE, ClearError, a command that there is not, slvChangeMode refused.
    """
    operator.ready()
    replies = [
        operator.robot("Motor", i4(1)),
        operator.robot("SLVCHANGEMODE", i2(2)),
        operator.robot("slvChangeMode", i2(0)),
        operator.command("ClearError"),
        operator.robot("NoSuchCommand"),
        operator.robot("slvChangeMode", i2(0x333)),
    ]
    assert [each.hresult for each in replies] == [0, 0, 0, 0, 0x80010005, 0x80070057]
    return [each.vt for each in replies]


@pytest.mark.parametrize("profile", sorted(PROFILES))
@pytest.mark.parametrize("no_argument", ["", "never", "slvchangemode", "always"])
def test_which_replies_carry_no_argument(profile: str, no_argument: str) -> None:
    usual = "slvchangemode" if profile == "rc7" else "never"
    empty, bare = VT.EMPTY, None
    expected = {
        "never": [empty, empty, empty, empty, empty, empty],
        "slvchangemode": [empty, bare, bare, empty, empty, bare],
        "always": [bare, bare, bare, bare, bare, bare],
    }
    assert empties(Operator(simulation(profile, no_argument))) == expected[no_argument or usual]


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_calls_that_return_nothing_never_carry_an_argument(profile: str) -> None:
    operator = Operator(simulation(profile, "never"))
    variable = operator.get("Controller_GetVariable", operator.controller, "I1")
    assert operator.call("Variable_PutValue", variable, i4(1)).vt is None
    assert operator.call("Robot_Halt", operator.arm, bstr("")).vt is None
    assert operator.call("Variable_Release", variable).vt is None


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_csharp_and_java_find_an_argument_in_each_successful_reply(profile: str) -> None:
    """They read the first argument of each function that returns something without checking the count."""
    operator = Operator(Simulation(profile), tcp=True)
    for function in _RETURNING:
        handle = operator.controller if function.owner == "Controller" else operator.arm
        reply = operator.call(function.name, handle, bstr("ClearError"), bstr(""))
        assert reply.hresult != 0 or reply.vt is not None, function.name
