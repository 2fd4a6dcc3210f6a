"""Times: even or not, sent or due, with records missing."""

from __future__ import annotations

import numpy as np
import pytest

from bcapscope.player.trajectory import (
    MAX_PARTS,
    find_runs,
    timing_from_due_times,
    timing_from_send_times,
)


@pytest.mark.parametrize(
    ("times", "period"),
    [
        ([0, 0.008, 0.016], 0.008),
        ([5, 5.01, 5.02], 0.01),
        ([0, 0.00801, 0.016], 0.008),
        ([0, 0.008, 0.024], None),
        ([0, 0.0, 0.0], None),
        ([0, -1, -2], None),
        ([3], None),
        ([0, float("nan"), 1], None),
    ],
)
def test_times_that_tell_when_points_are_due(times: list[float], period: float | None) -> None:
    found = timing_from_due_times(np.array(times))
    assert found.period == (period if period is None else pytest.approx(period))
    assert found.times is not None
    assert found.times[0] == 0


def test_sent_points_count_as_cycles_whenever_they_were_sent() -> None:
    burst = np.array([0, 0.0003, 0.0006, *np.arange(1, 20) * 0.008])
    found = timing_from_send_times(burst)
    assert (found.period, found.times) == (0.008, None)
    pause = timing_from_send_times(np.array([0, 0.001, 0.002, 0.003, 0.053]))
    assert pause.period == 0.001
    assert "the longest pause between two set points was 50 ms" in str(pause.notes[-1])
    assert timing_from_send_times(np.array([1.0])).period == 0.008


def test_points_sent_at_another_pace_keep_their_times() -> None:
    found = timing_from_send_times(np.array([0, 0.02, 0.041, 0.06]))
    assert found.period is None
    assert found.times is not None


@pytest.mark.parametrize(
    ("counter", "parts", "step"),
    [
        ([8, 16, 24], [(0, 3)], 8),
        ([1, 2, 3, 9, 10, 11], [(0, 3), (3, 6)], 1),
        ([100, 108, 117, 124], [(0, 4)], 8),
        ([90, 98, 106, 2, 10], [(0, 3), (3, 5)], 8),
        ([8, 16, 16, 24, 32], [(0, 2), (2, 5)], 8),
        ([5], [(0, 1)], None),
        ([7, 7, 7], [(0, 3)], None),
        ([1, float("inf"), 3], [(0, 3)], None),
    ],
)
def test_where_records_follow_each_other(
    counter: list[float], parts: list[tuple[int, int]], step: float | None
) -> None:
    assert find_runs(np.array(counter, dtype=float)) == (tuple(map(tuple, parts)), step)


def test_a_counter_that_jumps_all_the_time_says_nothing() -> None:
    counter = np.cumsum([1, 1, 1, 9] * (MAX_PARTS + 1)).astype(float)
    assert find_runs(counter) == (((0, len(counter)),), None)
