"""Only motion counts for the pace of set points."""

from __future__ import annotations

import pytest

from bcapscope.analysis.slave.motion_pace import MotionPace
from tests.analysis.driving import Plan, joints


def _pace(steps: list[tuple[float, float]], takes: float = 0.5) -> MotionPace | None:
    """Return the pace of set points, each given as its time in ms and the position of J1."""
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x202)
    for ms, position in steps:
        driver.move(ms, joints(position), takes=takes)
    (session,) = plan.stays()
    return session.pace


def _run(start: float, count: int, every: float, first: float, step: float) -> list[tuple[float, float]]:
    return [(start + index * every, first + index * step) for index in range(count)]


def test_a_pause_at_standstill_does_not_count() -> None:
    moves = _run(10, 60, 8, 0.0, 0.1)
    stands = _run(490, 20, 100, 5.9, 0.0)
    again = _run(2490, 60, 8, 5.9, 0.1)
    pace = _pace(moves + stands + again)
    assert pace is not None
    assert pace.cycle_ms == pytest.approx(8)
    assert pace.skipped == 0
    assert pace.cycles == 58 + 58


def test_a_client_that_holds_still_has_no_pace() -> None:
    assert _pace(_run(10, 60, 100, 1.0, 0.0)) is None


def test_a_pause_between_two_steps_is_no_cycle_of_the_pace() -> None:
    pace = _pace(_run(10, 60, 8, 0.0, 0.1) + _run(3000, 60, 8, 6.0, 0.1))
    assert pace is not None
    assert pace.skipped == 0
    assert pace.cycle_ms == pytest.approx(8)


@pytest.mark.parametrize("every", [3.2, 8.0, 9.5, 16.0, 32.0])
def test_the_pace_of_steady_motion(every: float) -> None:
    pace = _pace(_run(10, 100, every, 0.0, 0.1))
    assert pace is not None
    assert pace.cycle_ms == pytest.approx(every)
    assert pace.skipped == (98 if every >= 12 else 0)


def test_a_few_late_set_points_do_not_change_the_pace() -> None:
    times = [10 + index * 8 + index // 10 * 8 for index in range(100)]
    pace = _pace([(ms, index / 10) for index, ms in enumerate(times)])
    assert pace is not None
    assert pace.cycle_ms == pytest.approx(8)
    assert pace.skipped == 9


@pytest.mark.parametrize(("takes", "waits"), [(8.6, True), (7.9, False), (0.5, False)])
def test_whether_the_client_waits_for_each_reply(takes: float, waits: bool) -> None:
    pace = _pace(_run(10, 100, 9.2, 0.0, 0.1), takes)
    assert pace is not None
    assert pace.waits_for_reply is waits


def test_a_cycle_after_lost_packets_does_not_count() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x202)
    for index in range(80):
        lost = index % 4 == 3
        driver.move(10 + index * 16, joints(index / 10), retries=(4.0, 8.0) if lost else ())
    (session,) = plan.stays()
    assert session.pace is not None
    assert session.pace.cycles == 78 - 19


@pytest.mark.parametrize("missing", [True, False])
def test_a_cycle_in_which_the_capture_lacks_a_set_point_does_not_count(missing: bool) -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x202)
    for index in range(80):
        late = index % 4 == 3
        if late and missing:
            driver.skip_serial()
        driver.move(10 + index * 8 + index // 4 * 8, joints(index / 10))
    (session,) = plan.stays()
    assert session.pace is not None
    assert (session.pace.cycles, session.pace.skipped) == ((78 - 20, 19) if missing else (78, 19))
