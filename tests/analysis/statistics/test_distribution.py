"""Percentiles and bins against the values themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.statistics.distribution import EXACT_UP_TO, Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary

SHARES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p999": 0.999}
NEAR = 0.004


def spread(values: Sequence[float], pieces: int = 1, bins: bool = False) -> DistributionSummary:
    histogram = Histogram()
    for piece in np.array_split(np.array(values, np.float64), pieces):
        histogram.add(piece)
    found = histogram.distribution(bins)
    assert found is not None
    return found


def nearest_rank(values: Sequence[float], share: float) -> float:
    return sorted(values)[max(math.ceil(round(share * len(values), 6)), 1) - 1]


@given(st.lists(st.floats(0, 1e9), min_size=1, max_size=300), st.integers(1, 5))
def test_few_values_are_told_exactly(values: list[float], pieces: int) -> None:
    found = spread(values, pieces)
    assert (found.count, found.least, found.most) == (len(values), min(values), max(values))
    for name, share in SHARES.items():
        assert getattr(found, name) == nearest_rank(values, share)
    assert found.least <= found.mean <= found.most
    assert found.mean == pytest.approx(sum(values) / len(values))


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32), st.sampled_from(["lognormal", "exponential", "uniform", "one"]), st.integers(1, 9)
)
def test_many_values_are_told_within_the_width_of_a_bin(seed: int, kind: str, pieces: int) -> None:
    chance = np.random.default_rng(seed)
    size = EXACT_UP_TO * 2 + 17
    values = {
        "lognormal": chance.lognormal(2, 1, size),
        "exponential": chance.exponential(0.01, size),
        "uniform": chance.uniform(0, 20, size),
        "one": np.full(size, 8.0),
    }[kind]
    found = spread(values.tolist(), pieces)
    assert (found.count, found.least, found.most) == (size, values.min(), values.max())
    for name, share in SHARES.items():
        assert getattr(found, name) == pytest.approx(nearest_rank(values.tolist(), share), rel=NEAR)
    assert found.mean == pytest.approx(values.mean())


def test_what_is_no_value_is_left_out() -> None:
    found = spread([1.0, math.nan, -1.0, math.inf, 3.0])
    assert (found.count, found.least, found.most, found.p50) == (2, 1.0, 3.0, 1.0)


def test_nothing_has_no_distribution() -> None:
    histogram = Histogram()
    histogram.add(np.array([math.nan, -2.0]))
    assert histogram.distribution() is None


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=100))
def test_bins_hold_each_value_once(values: list[float]) -> None:
    bins = spread(values, bins=True).bins
    assert sum(each.count for each in bins) == len(values)
    assert all(a.high <= b.low for a, b in pairwise(bins))
    for value in values:
        assert any(each.low <= value < each.high for each in bins)


def test_values_beyond_all_bins_are_kept_in_the_outermost() -> None:
    found = spread([0.0, 5e-324, 1e300] + [1.0] * EXACT_UP_TO, bins=True)
    assert (found.least, found.most) == (0.0, 1e300)
    assert found.p50 == pytest.approx(1.0, rel=NEAR)
    assert (found.bins[0].count, found.bins[-1].count) == (2, 1)


@pytest.mark.parametrize(
    ("first", "second"),
    [(10, 20), (EXACT_UP_TO + 1, 20), (20, EXACT_UP_TO + 1), (EXACT_UP_TO + 1, EXACT_UP_TO + 1)],
)
def test_merged_is_as_if_taken_in_by_one(first: int, second: int) -> None:
    chance = np.random.default_rng(first)
    values = chance.lognormal(1, 1, first + second)
    one, other = Histogram(), Histogram()
    one.add(values[:first])
    other.add(values[first:] * 100)
    one.merge(other)
    found = one.distribution(bins=True)
    whole = spread([*values[:first].tolist(), *(values[first:] * 100).tolist()], bins=True)
    assert found is not None
    assert (found.count, found.least, found.most) == (whole.count, whole.least, whole.most)
    assert found.p90 == pytest.approx(whole.p90, rel=NEAR)
    assert sum(each.count for each in found.bins) == first + second


def test_asking_changes_nothing() -> None:
    histogram = Histogram()
    for _ in range(3):
        histogram.add(np.arange(EXACT_UP_TO, dtype=np.float64))
        assert histogram.distribution() == histogram.distribution()
    found = histogram.distribution()
    assert found is not None
    assert found.count == 3 * EXACT_UP_TO


def test_another_unit() -> None:
    found = spread([1.0, 2.0, 3.0]).scaled(125.0)
    assert (found.count, found.least, found.p50, found.most, found.mean) == (3, 125.0, 250.0, 375.0, 250.0)


def test_asking_does_not_change_what_follows() -> None:
    values = np.random.default_rng(1).exponential(size=(300, 100))
    asked, never_asked = Histogram(), Histogram()
    for row in values:
        for histogram in (asked, never_asked):
            histogram.add(row)
        asked.distribution(bins=True)
    assert asked.distribution(bins=True) == never_asked.distribution(bins=True)
