"""Set points inside the controller."""

from __future__ import annotations

from bcapscope.protocol.slave_mode.modes import PERIOD_NS, Generation, slave_mode_by_number
from bcapscope.simulator.arm import ENCODER_LAG_NS, MS, Arm
from bcapscope.simulator.kinematics import HOME
from bcapscope.simulator.slave_drive import SlaveDrive


def _entered(arm: Arm) -> SlaveDrive:
    drive = SlaveDrive(arm)
    mode = slave_mode_by_number(0x102, Generation.RC8)
    assert mode is not None
    drive.enter(mode, 0)
    return drive


def test_whole_numbers_become_joints_like_all_others() -> None:
    arm = Arm(HOME)
    drive = _entered(arm)
    drive.push((0, 0, 90, 0, 90, 0, 0, 0))
    assert drive.advance(PERIOD_NS) is None
    assert all(isinstance(joint, float) for joint in arm.actual(PERIOD_NS + ENCODER_LAG_NS))


def test_the_arm_is_between_the_same_steps_whatever_was_looked_at_before() -> None:
    arm, fresh = Arm(HOME), Arm(HOME)
    drives = _entered(arm), _entered(fresh)
    for cycle in range(1, 30):
        for drive in drives:
            drive.push((cycle * 0.01, *HOME[1:]))
            assert drive.advance(cycle * PERIOD_NS) is None
        for ago in (0, 3, 0, ENCODER_LAG_NS // MS, 11, ENCODER_LAG_NS // MS):
            arm.commanded(cycle * PERIOD_NS - ago * MS)
    now = 29 * PERIOD_NS
    for each in range(now - 5 * PERIOD_NS, now, 3 * MS):
        assert arm.commanded(each) == fresh.commanded(each)
    arm.halt(now)
    fresh.halt(now)
    assert arm.commanded(now - MS) == fresh.commanded(now - MS) == arm.goal
