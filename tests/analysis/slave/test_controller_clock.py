"""The controller's clock, with a drift, a unit and a wrap that are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bcapscope.analysis.slave.controller_clock import ClockFacts, ControllerClock
from bcapscope.analysis.statistics.distribution import Floats

NS_PER_MS = 1_000_000
WORD = 1 << 32


def stamps_of(milliseconds: NDArray[np.floating[Any]], microseconds: bool, boot: int = 0) -> Floats:
    """Write times as a signed 32-bit number of the unit."""
    ticks = np.rint(milliseconds * (1000 if microseconds else 1)).astype(np.int64) + boot
    wrapped: Floats = ((ticks + WORD // 2) % WORD - WORD // 2).astype(np.float64)
    return wrapped


def told(
    stamps: NDArray[np.floating[Any]], seen: NDArray[np.floating[Any]], unit: bool | None, pieces: int = 1
) -> ClockFacts:
    clock = ControllerClock(unit)
    times = np.rint(seen * NS_PER_MS).astype(np.int64)
    for some, when in zip(np.array_split(stamps, pieces), np.array_split(times, pieces), strict=True):
        clock.add(some.astype(np.float64), when)
    facts = clock.facts()
    assert facts is not None
    return facts


@settings(max_examples=30, deadline=None)
@given(
    drift=st.floats(-300, 300),
    unit=st.booleans(),
    known=st.booleans(),
    pieces=st.integers(1, 4),
    boot=st.sampled_from([0, 2**31 - 5_000_000, -5_000_000, 2**31 - 300]),
    seed=st.integers(0, 1000),
)
def test_drift_is_found_across_wraps(
    *, drift: float, unit: bool, known: bool, pieces: int, boot: int, seed: int
) -> None:
    seen = np.arange(5000.0) * 8 + np.random.default_rng(seed).uniform(0, 0.2, 5000)
    own = np.arange(5000.0) * 8 * (1 + drift / 1e6)
    facts = told(stamps_of(own, unit, boot), seen, unit if known else None, pieces)
    assert facts.microseconds == unit
    # 40 s in whole milliseconds tell no more than 25 ppm
    assert facts.drift_ppm == pytest.approx(drift, abs=2 if unit else 25)
    assert (facts.missing, facts.repeated, facts.backwards) == (0, 0, 0)
    assert facts.stamps == 5000
    assert str(facts.unit_known_by) == ("slvRecvFormat" if known else "the pace of the time stamps")


def test_each_wrap_is_counted() -> None:
    seen = np.arange(1.0, 2000.0) * 8_000  # 4.4 hours of µs wrap 3 times
    facts = told(stamps_of(seen, True), seen, True, 7)
    assert facts.wraps == int(seen[-1] * 1000 + WORD // 2) // WORD
    assert facts.wraps > 2
    assert facts.drift_ppm == pytest.approx(0, abs=0.01)


def test_missing_and_repeated_periods() -> None:
    own = np.array([0.0, 8.0, 16.0, 16.0, 40.0, 48.0, 47.0])
    facts = told(stamps_of(own, True), np.arange(7.0) * 8, True)
    assert (facts.missing, facts.repeated, facts.backwards) == (2, 1, 1)
    assert facts.step is not None
    assert (facts.step.most, facts.step.least, facts.step.count) == (24.0, 0.0, 5)
    assert facts.drift_ppm is None  # 48 ms are too few


def test_jitter_is_how_the_delay_changes() -> None:
    facts = told(np.arange(4.0) * 8000, np.array([0.5, 8.5, 17.5, 24.5]), True)
    assert facts.jitter is not None
    assert facts.jitter.most == pytest.approx(1.0)
    assert facts.jitter.p50 == pytest.approx(1.0)
    assert facts.jitter.least == pytest.approx(0.0)


def test_without_stamps_there_is_nothing_to_tell() -> None:
    clock = ControllerClock(None)
    clock.add(np.empty(0), np.empty(0, np.int64))
    assert clock.facts() is None


@given(st.lists(st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**60), 2**60)), min_size=1))
def test_no_stamps_break_it(pairs: list[tuple[int, int]]) -> None:
    clock = ControllerClock(None)
    stamps, times = zip(*pairs, strict=True)
    with np.errstate(all="ignore"):
        clock.add(np.array(stamps, np.float64), np.array(times, np.int64))
    facts = clock.facts()
    assert facts is not None
    assert facts.stamps == len(pairs)
