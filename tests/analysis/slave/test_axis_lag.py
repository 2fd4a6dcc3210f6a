"""A lag that is known is found."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.slave.axis_lag import MAX_CYCLES, AxisLag
from bcapscope.analysis.statistics.distribution import Floats


def curve(cycles: Floats) -> Floats:
    """Three axes: two that move, each in its way, one that stands still."""
    return np.column_stack((30 * np.sin(cycles / 40), 10 * np.cos(cycles / 25), np.full(len(cycles), 7.0)))


def found(lag: float, pieces: int = 1, answered: float = 1.0, noise: float = 0.0) -> AxisLag:
    chance = np.random.default_rng(1)
    cycles = np.arange(1000.0)
    commanded, returned = curve(cycles), curve(cycles - lag)
    returned += chance.normal(0, noise, returned.shape) if noise else 0.0
    there = chance.uniform(0, 1, len(cycles)) < answered
    returned[~there] = np.nan
    model = AxisLag(3)
    columns = zip(*(np.array_split(each, pieces) for each in (commanded, returned, there)), strict=True)
    for some, back, came in columns:
        model.add(some, back, came)
    return model


@settings(max_examples=40, deadline=None)
@given(
    lag=st.floats(0, MAX_CYCLES - 2),
    pieces=st.integers(1, 12),
    answered=st.sampled_from([1.0, 0.9]),
    noise=st.sampled_from([0.0, 0.005]),
)
def test_lag_of_a_motion(lag: float, pieces: int, answered: float, noise: float) -> None:
    model = found(lag, pieces, answered, noise)
    assert model.of_axis(0) == pytest.approx(lag, abs=0.25)
    assert model.of_all() == pytest.approx(lag, abs=0.25)


def test_no_lag_where_what_comes_back_is_what_was_sent() -> None:
    assert found(0).of_all() == pytest.approx(0.0, abs=0.01)


def test_none_for_an_axis_that_stands_still() -> None:
    assert found(4).of_axis(2) is None


def test_none_beyond_what_is_looked_for() -> None:
    assert found(60).of_axis(0) is None


def test_none_without_enough_set_points() -> None:
    model = AxisLag(1)
    model.add(np.zeros((MAX_CYCLES, 1)), np.zeros((MAX_CYCLES, 1)), np.ones(MAX_CYCLES, np.bool_))
    assert (model.of_axis(0), model.of_all()) == (None, None)
