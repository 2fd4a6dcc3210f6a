"""Cycles, latencies and what a time-out would have missed, against the times that were made up."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.slave.timing_model import MAX_SLOWEST, choose_grid
from bcapscope.traffic.observation import Transport
from tests.analysis.driving import Plan, watched
from tests.traffic.playbook import Script, slv_move

MICROSECOND = 0.001


def driven(
    times: Sequence[float],
    takes: Sequence[float | None],
    mode: int = 0x202,
    transport: Transport = Transport.UDP,
) -> SlaveSession:
    plan = Plan()
    driver = plan.driver(transport=transport)
    driver.change(-8, mode)
    for ms, each in zip(times, takes, strict=True):
        driver.move(ms, takes=each)
    driver.change(times[-1] + 1000, 0)
    (stay,) = plan.stays()
    return stay


def rank(values: list[float], share: float) -> float:
    return sorted(values)[math.ceil(round(share * len(values), 6)) - 1]


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.floats(3, 90), min_size=1, max_size=60),
    st.lists(st.none() | st.floats(0.1, 2.5), min_size=61, max_size=61),
)
def test_generated_times_are_found_again(gaps: list[float], takes: list[float | None]) -> None:
    gaps = [round(gap, 3) for gap in gaps]
    times = np.cumsum([0.0, *gaps]).round(3).tolist()
    stay = driven(times, [None if each is None else round(each, 3) for each in takes[: len(times)]])
    timing, counts = stay.timing, stay.counts
    answered = [each for each in takes[: len(times)] if each is not None]
    assert (counts.sent, counts.unanswered) == (len(times), len(times) - len(answered))
    assert timing.cycle is not None
    assert timing.jitter is not None
    for name, share in (("p50", 0.5), ("p90", 0.9), ("p99", 0.99)):
        assert getattr(timing.cycle, name) == pytest.approx(rank(gaps, share), abs=MICROSECOND)
    assert timing.cycle.most == pytest.approx(max(gaps), abs=MICROSECOND)
    assert timing.jitter.most == pytest.approx(max(abs(gap - 8) for gap in gaps), abs=MICROSECOND)
    assert timing.rate_hz == pytest.approx(len(gaps) / (times[-1] / 1000), rel=1e-6)
    assert timing.gaps == sum(gap > 24 for gap in gaps)
    assert [fact.cycle_ms for fact in timing.gap_list] == [gap for gap in gaps if gap > 24][:MAX_LISTED]
    assert (timing.latency and timing.latency.count) == (len(answered) or None)
    late = sum(round(each, 3) > 2 for each in answered)
    assert timing.deadlines[0].late == late + counts.unanswered
    assert timing.deadlines[3].late == counts.unanswered


def test_what_is_late_by_each_recommendation() -> None:
    times = [40.0 * n for n in range(1, 7)]
    stay = driven(times, [1.0, 3.0, 9.0, 17.0, 30.0, None])
    sync, async_, waiting, other = stay.timing.deadlines
    assert (sync.timeout_ms, sync.tries, sync.late, sync.given_up) == (2.0, 8, 5, 3)
    assert (async_.timeout_ms, async_.tries, async_.late, async_.given_up) == (2.0, 1, 5, 5)
    assert (waiting.timeout_ms, waiting.tries, waiting.late, waiting.given_up) == (16.0, 3, 3, 1)
    assert (other.timeout_ms, other.tries, other.late, other.given_up) == (8.0, 3, 4, 2)
    assert [each.applies for each in stay.timing.deadlines] == [False, False, True, False]
    assert [fact.latency_ms for fact in stay.timing.slowest] == [None, 30.0, 17.0, 9.0, 3.0, 1.0]


@pytest.mark.parametrize(
    ("mode", "transport", "applying"),
    [
        (0x002, Transport.UDP, [3]),
        (0x102, Transport.UDP, [1, 3]),
        (0x102, Transport.TCP, [3]),
        (0x202, Transport.TCP, [2]),
    ],
)
def test_which_recommendation_is_meant(mode: int, transport: Transport, applying: list[int]) -> None:
    stay = driven([8.0, 16.0], [0.5, 0.5], mode, transport=transport)
    assert [n for n, each in enumerate(stay.timing.deadlines) if each.applies] == applying


def test_the_slowest_are_listed_worst_first() -> None:
    stay = driven([8.0 * n for n in range(1, 101)], [0.5 + n / 100 for n in range(100)])
    slowest = [fact.latency_ms or 0.0 for fact in stay.timing.slowest]
    assert len(slowest) == MAX_SLOWEST
    assert slowest == sorted(slowest, reverse=True)
    assert slowest[0] == pytest.approx(1.49)


def test_a_reply_after_the_end_of_the_capture_is_no_miss() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x202)
    driver.moves([8.0, 16.0])
    driver.move(24.0, takes=None)
    (stay,) = plan.stays()
    assert (stay.counts.unanswered, stay.counts.open, stay.timing.deadlines[2].late) == (0, 1, 0)


def test_retries_count_from_the_first_request() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x202)
    driver.move(8.0, retries=(16.0,), takes=1.0)
    driver.move(40.0, takes=1.0)
    (stay,) = plan.stays()
    assert stay.timing.latency is not None
    assert stay.timing.rtt is not None
    assert (stay.timing.latency.most, stay.timing.rtt.most) == (17.0, 1.0)
    assert stay.timing.cycle is not None
    assert stay.timing.cycle.most == 32.0


@pytest.mark.parametrize(
    ("overwrites", "pace", "grid"),
    [(False, 1.0, 8), (True, 1.0, 1), (True, 8.0, 8), (None, 1.2, 1), (None, 7.0, 8), (True, None, 8)],
)
def test_the_grid_is_that_of_the_mode_and_the_traffic(
    overwrites: bool | None, pace: float | None, grid: int
) -> None:
    cycles = np.array([] if pace is None else [pace] * 5)
    found = choose_grid(overwrites, cycles)
    assert found.ms == grid
    assert found.known_by


def test_a_loop_of_1_ms_where_the_newest_point_wins() -> None:
    stay = driven([1.0 * n for n in range(1, 201)], [0.3] * 200, 0x102)
    assert stay.timing.grid_ms == 1.0
    assert stay.timing.on_grid == 199
    assert stay.buffer.overwritten > 150


def test_set_points_seen_out_of_order() -> None:
    script = Script()
    client = script.client()
    for serial, ms in enumerate((8.0, 24.0, 16.0, 32.0), 1):
        client.ask(ms, serial, 0, slv_move(ms))
        client.reply(ms + 1, serial)
    (stay,) = watched(script.track())
    assert stay.timing.cycle is not None
    assert (stay.timing.backwards, stay.timing.cycle.count) == (1, 2)
