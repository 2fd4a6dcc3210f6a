"""The buffer of set points."""

from __future__ import annotations

import pytest

from bcapscope.protocol.slavemode import slave_mode
from bcapscope.simulator.arm import Arm
from bcapscope.simulator.drive import PERIOD, SlaveDrive
from bcapscope.simulator.kinematics import HOME

TOO_FAST = 0x84204051
MODE_1, MODE_2 = 0x102, 0x202


def moving(value: int) -> SlaveDrive:
    """Return a drive whose J1 turns by 0.2 degrees in 8 ms; two set points are taken."""
    mode = slave_mode(value)
    assert mode is not None
    drive = SlaveDrive(Arm(HOME))
    drive.enter(mode, 0)
    assert [taken(drive, number, 0.2 * number) for number in (1, 2)] == [0, 0]
    return drive


def taken(drive: SlaveDrive, tick: int, degrees: float) -> int:
    """Send a set point, and let it be taken; return the result."""
    drive.push((degrees, *HOME[1:]))
    fault = drive.advance(tick * PERIOD)
    return fault.code if fault else 0


@pytest.mark.parametrize(("mode", "code"), [(MODE_1, 0), (MODE_2, TOO_FAST)])
def test_only_who_sets_the_pace_may_have_gone_on_while_the_time_stood_still(mode: int, code: int) -> None:
    drive = moving(mode)
    drive.pardon(2 * PERIOD)
    assert taken(drive, 3, 5.0) == code


def test_after_the_time_stood_still_limits_hold_again() -> None:
    drive = moving(MODE_1)
    drive.pardon(2 * PERIOD)
    assert [taken(drive, 3, 5.0), taken(drive, 4, 5.2), taken(drive, 5, 5.4)] == [0, 0, 0]
    assert taken(drive, 6, 10.0) == TOO_FAST


def test_a_jump_without_reason_is_too_fast() -> None:
    assert taken(moving(MODE_1), 3, 5.0) == TOO_FAST
