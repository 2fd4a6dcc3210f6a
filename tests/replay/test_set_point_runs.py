"""What is sent again goes through the player's pre-flight."""

from __future__ import annotations

import pytest

from bcapscope.player.arm_limits import UNKNOWN_ARM, with_limits
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.replay.replay_script import ReplayScript, ScriptCall
from bcapscope.replay.set_point_runs import UnreadableSetPointError, preflight_run, set_point_runs
from bcapscope.traffic.call_kind import CallKind
from tests.faults.traffic import talk

MS = 1_000_000
HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)


def script(*asked: tuple[str, Variant | None, int], code: int = 0) -> ReplayScript:
    """Make a script of commands, with their parameters and times in ms."""
    lines = []
    for number, (command, parameter, at) in enumerate(asked, 1):
        arguments = (Variant(VT.I4, 1), Variant(VT.BSTR, command), *([parameter] if parameter else []))
        lines.append(ScriptCall(number, CallKind(64, command), arguments, at * MS, code, (), 0, ()))
    return ReplayScript(talk().up.conversation, tuple(lines), ReplyReserved.ZERO)


def mode(value: int, at: int = 0) -> tuple[str, Variant, int]:
    return "slvChangeMode", Variant(VT.I4, value), at


def point(at: int, first: float = 0.0, width: int = 8) -> tuple[str, Variant, int]:
    return "slvMove", Variant.array(VT.R8, (first, *HOME[1:width])), at


def test_each_stay_is_looked_at_with_what_the_controller_refused() -> None:
    asked = [mode(0x202), *(point(8 * n) for n in range(4)), mode(0), mode(0x201), point(99, width=7)]
    first, second = set_point_runs(script(*asked, code=0x84201482))
    assert (first.first_call, first.trajectory.kind, first.trajectory.points.shape) == (2, PoseType.J, (4, 8))
    assert first.trajectory.period == 0.008
    assert (second.first_call, second.trajectory.kind) == (8, PoseType.P)
    assert preflight_run(first, UNKNOWN_ARM).is_playable


def test_a_jump_is_not_fit_to_be_played() -> None:
    asked = [mode(0x202), *(point(8 * n, 0.0 if n < 4 else 60.0) for n in range(8))]
    (found,) = set_point_runs(script(*asked))
    checked = preflight_run(found, UNKNOWN_ARM)
    assert [each.check for each in checked.problems if each.severity == "error"] == ["speed"]


def test_limits_of_the_arm_hold() -> None:
    asked = [mode(0x202), *(point(8 * n, 0.01 * n) for n in range(20))]
    (found,) = set_point_runs(script(*asked))
    assert preflight_run(found, UNKNOWN_ARM).is_playable
    assert not preflight_run(found, with_limits(UNKNOWN_ARM, ["J1.speed=1"])).is_playable
    assert not preflight_run(found, with_limits(UNKNOWN_ARM, ["J1=-1..0.1"])).is_playable


def test_a_pause_is_told() -> None:
    asked = [mode(0x202), *(point(8 * n + (500 if n > 5 else 0)) for n in range(20))]
    (found,) = set_point_runs(script(*asked))
    gap = next(each for each in preflight_run(found, UNKNOWN_ARM).problems if each.check == "gap")
    assert (gap.points, gap.severity) == ((7,), "warning")


@pytest.mark.parametrize(
    "asked",
    [
        ("slvMove", None, 8),
        ("slvMove", Variant(VT.BSTR, "P(1, 2, 3)"), 8),
        point(8, width=3),
        point(8, width=7),
    ],
)
def test_a_set_point_that_cannot_be_read_is_not_sent(asked: tuple[str, Variant | None, int]) -> None:
    with pytest.raises(UnreadableSetPointError, match="call 3 is a set point"):
        list(set_point_runs(script(mode(0x202), point(0), asked)))
