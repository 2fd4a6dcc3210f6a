"""Armed or not."""

from __future__ import annotations

from bcapscope.tui.desk.arming import LAPSES_AFTER, Arming


def test_it_lapses_unless_it_is_used() -> None:
    arming = Arming()
    assert not arming.lets_pass(0)
    arming.arm(0)
    assert arming.lets_pass(LAPSES_AFTER - 1)
    arming.used(LAPSES_AFTER - 1)
    assert arming.left(LAPSES_AFTER) == LAPSES_AFTER - 1
    assert arming.lets_pass(LAPSES_AFTER)
    assert not arming.lets_pass(2 * LAPSES_AFTER)
    arming.used(2 * LAPSES_AFTER)
    assert not arming.is_armed(2 * LAPSES_AFTER)
    assert arming.left(2 * LAPSES_AFTER) == 0


def test_it_can_be_disarmed() -> None:
    arming = Arming()
    arming.arm(0)
    arming.disarm()
    assert not arming.is_armed(1)


def test_our_simulator_needs_none() -> None:
    arming = Arming()
    arming.needed = False
    assert arming.lets_pass(0)
    assert not arming.is_armed(0)
