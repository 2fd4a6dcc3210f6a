"""How late set points were sent, and how they are spread."""

from __future__ import annotations

from bcapscope.player.lateness import MOST_TOLD, Lateness


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
    assert len(bins) == MOST_TOLD
    assert bins == tuple(sorted(bins))
    assert min(count for _, _, count in bins) == 21


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
    assert len(bins) == MOST_TOLD
    assert bins == tuple(sorted(bins))
    assert min(count for _, _, count in bins) == 21
