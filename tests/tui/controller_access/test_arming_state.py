"""Armed or not."""

from __future__ import annotations

from bcapscope.live.controller.arming_state import DISARM_AFTER, ArmingState


def test_it_lapses_unless_it_is_used() -> None:
    arming = ArmingState()
    assert not arming.allows_armed_calls(0)
    arming.arm(0)
    assert arming.allows_armed_calls(DISARM_AFTER - 1)
    arming.extend(DISARM_AFTER - 1)
    assert arming.remaining(DISARM_AFTER) == DISARM_AFTER - 1
    assert arming.allows_armed_calls(DISARM_AFTER)
    assert not arming.allows_armed_calls(2 * DISARM_AFTER)
    arming.extend(2 * DISARM_AFTER)
    assert not arming.is_armed(2 * DISARM_AFTER)
    assert arming.remaining(2 * DISARM_AFTER) == 0


def test_it_can_be_disarmed() -> None:
    arming = ArmingState()
    arming.arm(0)
    arming.disarm()
    assert not arming.is_armed(1)


def test_our_simulator_needs_none() -> None:
    arming = ArmingState()
    arming.is_required = False
    assert arming.allows_armed_calls(0)
    assert not arming.is_armed(0)
