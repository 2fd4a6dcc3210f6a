"""Slices of time, each set point in one."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.slave import session_slices
from tests.analysis.driving import UNDERFLOW, Plan
from tests.traffic.playbook import START

MS = 1_000_000


@settings(deadline=None, max_examples=40)
@given(st.lists(st.integers(4, 300), min_size=1, max_size=50), st.integers(1, 500))
def test_each_set_point_is_in_the_slice_of_its_time(gaps: list[int], window: int) -> None:
    plan = Plan()
    driver = plan.driver()
    now, times = 0, []
    for n, gap in enumerate(gaps):
        now += gap
        times.append(now)
        driver.move(now, retries=(2.0,) if n % 3 == 0 else ())
    (stay,) = plan.stays(window * MS)
    numbers = [(ms - times[0]) // window for ms in times]
    assert [each.begin for each in stay.slices] == [
        START + (times[0] + n * window) * MS for n in sorted(set(numbers))
    ]
    assert [each.sent for each in stay.slices] == [numbers.count(n) for n in sorted(set(numbers))]
    assert sum(each.retries for each in stay.slices) == stay.counts.retries
    assert sum(each.cycle.count for each in stay.slices if each.cycle) == len(gaps) - 1


def test_figures_of_a_slice() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.moves([8.0, 16.0])
    driver.move(116.0, takes=None)
    driver.move(132.0, code=UNDERFLOW)
    (stay,) = plan.stays(100 * MS)
    first, second = stay.slices
    assert (first.sent, first.refused, first.unanswered, first.smallest_slack_ms) == (2, 0, 0, 0.0)
    assert (second.sent, second.refused, second.unanswered) == (2, 1, 1)
    assert second.cycle is not None
    assert second.cycle.most == 100.0
    assert second.latency is not None
    assert (second.latency.count, second.smallest_slack_ms) == (1, -92.0)


def test_slices_are_bounded() -> None:
    plan = Plan()
    plan.driver().moves(float(n * 10) for n in range(30))
    before, session_slices.MAX_SLICES = session_slices.MAX_SLICES, 20
    try:
        (stay,) = plan.stays(10 * MS)
    finally:
        session_slices.MAX_SLICES = before
    assert (len(stay.slices), stay.slices_left_off) == (20, 10)
