"""Percentiles while it runs, and exact ones afterwards."""

from __future__ import annotations

from math import ceil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.player.lateness import MAX_REPORTED_BINS, Lateness, Spread


def filled(values: list[int], capacity: int) -> Lateness:
    """Take values in."""
    lateness = Lateness(capacity)
    for value in values:
        lateness.add(value)
    return lateness


def true_spread(values: list[int]) -> Spread:
    """Return what is to be told, by definition."""
    ordered = sorted(values)
    p50, p99, p999 = (ordered[max(1, ceil(share * len(values))) - 1] for share in (0.5, 0.99, 0.999))
    return Spread(len(values), p50, p99, p999, ordered[-1])


@given(st.lists(st.integers(0, 10**10), min_size=1, max_size=300))
def test_exact_figures_are_those_of_the_sorted_values(values: list[int]) -> None:
    assert filled(values, 300).exact_spread() == true_spread(values)


@given(st.lists(st.integers(0, 10**10), min_size=1, max_size=300))
def test_quick_figures_are_never_too_small_and_at_most_a_bin_too_large(values: list[int]) -> None:
    quick, true = filled(values, 10).estimated_spread(), true_spread(values)
    assert (quick.count, quick.most) == (true.count, true.most)
    for name in ("p50", "p99", "p999"):
        assert getattr(true, name) <= getattr(quick, name) <= getattr(true, name) * 1.07


def test_nothing_is_nothing() -> None:
    assert Lateness(5).estimated_spread() == Lateness(5).exact_spread() == Spread()


@pytest.mark.parametrize("count", [5, 6])
def test_what_is_more_than_there_is_room_for_is_told_by_bins(count: int) -> None:
    values = [1_000_000 + number for number in range(count)]
    assert (filled(values, 5).exact_spread() == true_spread(values)) is (count == 5)


def test_bins_tell_what_they_hold() -> None:
    lateness = Lateness(10)
    for value in (3, 3, 8_000_000, 8_000_001, 12_000_000):
        lateness.add(value)
    bins = lateness.bins()
    assert bins[0] == (3, 3, 2)
    assert [count for _, _, count in bins] == [2, 2, 1]
    low, high, _ = bins[1]
    assert low <= 8_000_000 <= high < low * 1.07


def test_of_many_bins_those_are_told_that_hold_most() -> None:
    lateness = Lateness(10)
    for power in range(60):
        for _ in range(power + 1):
            lateness.add(1 << power)
    bins = lateness.bins()
    assert len(bins) == MAX_REPORTED_BINS
    assert bins == tuple(sorted(bins))
    assert min(count for _, _, count in bins) == 21
