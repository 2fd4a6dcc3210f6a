"""Limits: of the simulator, as users write them, and what holds where nothing is known."""

from __future__ import annotations

import pickle
from math import inf

import pytest

from bcapscope.player.arm_limits import MAX_ARM_SPEED, SIMULATED_ARM, UNKNOWN_ARM, limits_for_arm, with_limits
from bcapscope.simulator.kinematics import AXIS_LIMITS
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.profile import PROFILES

PROFILED = Machine(PROFILES["rc8"])


def test_those_of_the_simulated_arm_are_known_by_its_type() -> None:
    limits = limits_for_arm(PROFILED.initial_state.type_name)
    assert limits is SIMULATED_ARM
    assert limits.axis_count == len(AXIS_LIMITS)
    assert [limits.limit_for(f"J{axis}", "deg") for axis in range(1, 7)] == list(AXIS_LIMITS)
    assert "J7" not in limits.axes
    assert pickle.loads(pickle.dumps(limits)).axes == limits.axes


def test_an_arm_is_unknown_whose_type_is_not_known_or_not_told() -> None:
    assert limits_for_arm("VP-6242G") is limits_for_arm("") is UNKNOWN_ARM
    assert UNKNOWN_ARM.axis_count is None


def test_where_nothing_is_known_no_arm_is_as_fast() -> None:
    assert UNKNOWN_ARM.limit_for("J1", "deg") == (-inf, inf, MAX_ARM_SPEED["deg"], inf)
    assert UNKNOWN_ARM.limit_for("X", "mm").speed == MAX_ARM_SPEED["mm"]
    assert UNKNOWN_ARM.limit_for("Fig", "").speed == inf
    assert UNKNOWN_ARM.known_limit("J1").speed == inf


def test_limits_as_users_write_them() -> None:
    limits = with_limits(
        UNKNOWN_ARM, ["J1=-170..170.5", "j1..J2.speed = 30", " J2.acceleration=1e3", "X..Z.speed=100"]
    )
    assert limits.known_limit("J1") == (-170, 170.5, 30, inf)
    assert limits.known_limit("J2") == (-inf, inf, 30, 1000)
    assert limits.known_limit("Z").speed == 100
    assert "Rx" not in limits.axes
    narrower = with_limits(SIMULATED_ARM, ["J1.speed=10"])
    assert narrower.known_limit("J1") == (-170, 170, 10, 6000)
    assert SIMULATED_ARM.known_limit("J1").speed == 300


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not a limit"),
        ("J1", "is not a limit"),
        ("J1=", "is not a limit"),
        ("J1=5", "'5' is not a range"),
        ("J1=a..b", "'a..b' is not a range"),
        ("J1=1..inf", "is not a range"),
        ("J1=1..2..3", "is not a range"),
        ("J1=5..5", "5 is not below 5"),
        ("J1.speed=1..2", "'1..2' is not a number"),
        ("J1.speed=nan", "'nan' is not a number"),
        ("J1.speed=0", "speed must be above 0"),
        ("J1.force=3", "is not a limit"),
        ("J9=1..2", "axes are X, Y"),
        ("J3..J1.speed=2", "J1 does not come after J3"),
        ("Fig=0..1", "axes are"),
    ],
)
def test_limits_that_make_no_sense(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        with_limits(UNKNOWN_ARM, [text])
