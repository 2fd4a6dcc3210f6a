"""Limits: of the simulator, as users write them, and what holds where nothing is known."""

from __future__ import annotations

import pickle
from math import inf

import pytest

from bcapscope.player.limits import FASTEST, SIMULATED, UNKNOWN, limited, limits_of
from bcapscope.simulator.kinematics import LIMITS
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.profile import PROFILES

PROFILED = Machine(PROFILES["rc8"])


def test_those_of_the_simulated_arm_are_known_by_its_type() -> None:
    limits = limits_of(PROFILED.start.type_name)
    assert limits is SIMULATED
    assert limits.axis_count == len(LIMITS)
    assert [limits.of(f"J{axis}", "deg") for axis in range(1, 7)] == list(LIMITS)
    assert not limits.knows("J7")
    assert pickle.loads(pickle.dumps(limits)).axes == limits.axes


def test_an_arm_is_unknown_whose_type_is_not_known_or_not_told() -> None:
    assert limits_of("VP-6242G") is limits_of("") is UNKNOWN
    assert UNKNOWN.axis_count is None


def test_where_nothing_is_known_no_arm_is_as_fast() -> None:
    assert UNKNOWN.of("J1", "deg") == (-inf, inf, FASTEST["deg"], inf)
    assert UNKNOWN.of("X", "mm").speed == FASTEST["mm"]
    assert UNKNOWN.of("Fig", "").speed == inf
    assert UNKNOWN.told("J1").speed == inf


def test_limits_as_users_write_them() -> None:
    limits = limited(
        UNKNOWN, ["J1=-170..170.5", "j1..J2.speed = 30", " J2.acceleration=1e3", "X..Z.speed=100"]
    )
    assert limits.told("J1") == (-170, 170.5, 30, inf)
    assert limits.told("J2") == (-inf, inf, 30, 1000)
    assert limits.told("Z").speed == 100
    assert not limits.knows("Rx")
    narrower = limited(SIMULATED, ["J1.speed=10"])
    assert narrower.told("J1") == (-170, 170, 10, 6000)
    assert SIMULATED.told("J1").speed == 300


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is no limit"),
        ("J1", "is no limit"),
        ("J1=", "is no limit"),
        ("J1=5", "'5' is no range"),
        ("J1=a..b", "'a..b' is no range"),
        ("J1=1..inf", "is no range"),
        ("J1=1..2..3", "is no range"),
        ("J1=5..5", "5 is not below 5"),
        ("J1.speed=1..2", "'1..2' is no number"),
        ("J1.speed=nan", "'nan' is no number"),
        ("J1.speed=0", "speed has to be above 0"),
        ("J1.force=3", "is no limit"),
        ("J9=1..2", "axes are X, Y"),
        ("J3..J1.speed=2", "J1 does not come after J3"),
        ("Fig=0..1", "axes are"),
    ],
)
def test_limits_that_make_no_sense(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        limited(UNKNOWN, [text])
