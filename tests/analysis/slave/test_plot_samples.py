"""Runs of set points, each set point in just one."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.slave.plot_samples import MAX_SAMPLES, PlotSampler


def filled(sizes: list[int]) -> PlotSampler:
    """Take in set points of frame and cycle 0, 1, 2 and so on, in pieces of these sizes."""
    sampler = PlotSampler(1, 1000)
    begin = 0
    for size in sizes:
        numbers = np.arange(begin, begin + size)
        values = numbers.astype(np.float64)
        poses = values[:, None], -values[:, None]
        sampler.add(numbers * 8, numbers, (values, values * 2, -values), poses)
        begin += size
    return sampler


@settings(deadline=None, max_examples=40)
@given(st.lists(st.integers(1, 3000), min_size=1, max_size=8))
def test_each_set_point_is_in_one_run(sizes: list[int]) -> None:
    samples = filled(sizes).samples()
    total = sum(sizes)
    assert len(samples) <= MAX_SAMPLES
    assert len(samples) >= min(total, MAX_SAMPLES // 2)
    begin = 0
    for sample in samples:
        last = begin + sample.points - 1
        assert (sample.frame, sample.time) == (begin, 1000 + begin * 8)
        assert (sample.commanded, sample.returned) == ((float(begin),), (-float(begin),))
        assert (sample.cycle_least, sample.cycle_most, sample.latency_most) == (begin, last, 2 * last)
        assert sample.slack_least == -last
        begin += sample.points
    assert begin == total
    assert len({sample.points for sample in samples[:-1]}) <= 1


@given(st.lists(st.integers(1, 500), min_size=1, max_size=8))
def test_cutting_changes_nothing(sizes: list[int]) -> None:
    assert filled(sizes).samples() == filled([sum(sizes)]).samples()


def test_what_is_missing_stays_missing() -> None:
    sampler = PlotSampler(1, 0)
    nothing = np.full(1, np.nan)
    sampler.add(
        np.zeros(1, np.int64), np.ones(1, np.int64), (nothing, nothing, nothing), (nothing[:, None],) * 2
    )
    (sample,) = sampler.samples()
    assert math.isnan(sample.cycle_least)
    assert math.isnan(sample.commanded[0])
    assert sample.points == 1
