"""What is sent again goes through the player's pre-flight."""

from __future__ import annotations

import pytest

from bcapscope.player.limits import UNKNOWN, limited
from bcapscope.protocol.convention import ReplyReserved
from bcapscope.protocol.slavemode import PoseType
from bcapscope.protocol.variant import VT, Variant
from bcapscope.replay.script import Line, Script
from bcapscope.replay.setpoints import UnreadableError, preflight, stretches
from bcapscope.traffic.question import Question
from tests.faults.traffic import talk

MS = 1_000_000
HOME = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)


def script(*asked: tuple[str, Variant | None, int], code: int = 0) -> Script:
    """Make a script of commands, with their parameters and times in ms."""
    lines = []
    for number, (command, parameter, at) in enumerate(asked, 1):
        arguments = (Variant(VT.I4, 1), Variant(VT.BSTR, command), *([parameter] if parameter else []))
        lines.append(Line(number, Question(64, command), arguments, at * MS, code, (), 0, ()))
    return Script(talk().up.conversation, tuple(lines), ReplyReserved.ZERO)


def mode(value: int, at: int = 0) -> tuple[str, Variant, int]:
    return "slvChangeMode", Variant(VT.I4, value), at


def point(at: int, first: float = 0.0, width: int = 8) -> tuple[str, Variant, int]:
    return "slvMove", Variant.array(VT.R8, (first, *HOME[1:width])), at


def test_each_stay_is_looked_at_with_what_the_controller_refused() -> None:
    asked = [mode(0x202), *(point(8 * n) for n in range(4)), mode(0), mode(0x201), point(99, width=7)]
    first, second = stretches(script(*asked, code=0x84201482))
    assert (first.first, first.trajectory.kind, first.trajectory.points.shape) == (2, PoseType.J, (4, 8))
    assert first.trajectory.period == 0.008
    assert (second.first, second.trajectory.kind) == (8, PoseType.P)
    assert preflight(first, UNKNOWN).is_fit


def test_a_jump_is_not_fit_to_be_played() -> None:
    asked = [mode(0x202), *(point(8 * n, 0.0 if n < 4 else 60.0) for n in range(8))]
    (found,) = stretches(script(*asked))
    checked = preflight(found, UNKNOWN)
    assert [each.check for each in checked.findings if each.severity == "error"] == ["speed"]


def test_limits_of_the_arm_hold() -> None:
    asked = [mode(0x202), *(point(8 * n, 0.01 * n) for n in range(20))]
    (found,) = stretches(script(*asked))
    assert preflight(found, UNKNOWN).is_fit
    assert not preflight(found, limited(UNKNOWN, ["J1.speed=1"])).is_fit
    assert not preflight(found, limited(UNKNOWN, ["J1=-1..0.1"])).is_fit


def test_a_pause_is_told() -> None:
    asked = [mode(0x202), *(point(8 * n + (500 if n > 5 else 0)) for n in range(20))]
    (found,) = stretches(script(*asked))
    gap = next(each for each in preflight(found, UNKNOWN).findings if each.check == "gap")
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
    with pytest.raises(UnreadableError, match="call 3, a set point"):
        list(stretches(script(mode(0x202), point(0), asked)))
