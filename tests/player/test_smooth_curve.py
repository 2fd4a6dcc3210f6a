"""The curve through set points: it goes through them, smoothly, and not much faster than they do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.player.smooth_curve import Array, SmoothCurve, unwrap_rotations
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.player.ways import swing

STEP = 1e-4


@st.composite
def uneven(draw: st.DrawFn) -> tuple[Array, Array]:
    steps = draw(st.lists(st.floats(0.01, 2.0), min_size=1, max_size=12))
    values = draw(st.lists(st.floats(-100, 100), min_size=len(steps) + 1, max_size=len(steps) + 1))
    return np.concatenate(([0.0], np.cumsum(steps))), np.array(values)[:, None]


@given(uneven())
def test_it_goes_through_every_point(way: tuple[Array, Array]) -> None:
    knots, points = way
    assert SmoothCurve(PoseType.J, knots, points).sample(knots) == pytest.approx(points, abs=1e-9)


@given(uneven())
def test_it_is_c2(way: tuple[Array, Array]) -> None:
    knots, points = way
    curve = SmoothCurve(PoseType.J, knots, points)
    for knot in knots[1:-1].tolist():
        before, after = curve.sample(knot - STEP * np.arange(3)), curve.sample(knot + STEP * np.arange(3))
        speeds = (before[0] - before[1]) / STEP, (after[1] - after[0]) / STEP
        bends = np.diff(before, n=2, axis=0) / STEP**2, np.diff(after, n=2, axis=0) / STEP**2
        scale = max(float(np.abs(np.diff(points, axis=0) / np.diff(knots)[:, None]).max()), 1.0)
        width = float(np.diff(knots).min())
        assert speeds[0] == pytest.approx(speeds[1], abs=scale * STEP / width * 50)
        assert bends[0] == pytest.approx(bends[1], abs=scale * STEP / width**2 * 400)


@given(st.lists(st.floats(-100, 100), min_size=2, max_size=20))
def test_it_is_at_most_1_75_times_as_fast(values: list[float]) -> None:
    points, knots = np.array(values)[:, None], np.arange(len(values), dtype=float)
    curve = SmoothCurve(PoseType.J, knots, points)
    fine = curve.sample(np.linspace(0, knots[-1], 40 * len(values)))
    fastest = np.abs(np.diff(points, axis=0)).max()
    speed = np.abs(np.diff(fine, axis=0)).max() / (knots[-1] / (40 * len(values) - 1))
    assert speed <= 1.75 * fastest + 1e-6


def test_a_straight_line_stays_straight() -> None:
    curve = SmoothCurve(PoseType.J, np.array([0.0, 1.0, 3.0, 3.5]), np.array([[0.0], [2.0], [6.0], [7.0]]))
    where = np.linspace(0, 3.5, 50)
    assert curve.sample(where)[:, 0] == pytest.approx(2 * where)


def test_beyond_its_ends_it_rests() -> None:
    curve = SmoothCurve(PoseType.J, np.array([0.0, 1.0]), np.array([[3.0], [5.0]]))
    assert curve.sample(np.array([-9.0, 9.0])).tolist() == [[3.0], [5.0]]


def test_rotations_go_the_short_way_round() -> None:
    points = np.array([[0, 0, 0, 179.0, 0, -170, 1], [0, 0, 0, -179.0, 0, 170, 1]])
    (between,) = SmoothCurve(PoseType.P, np.array([0.0, 1.0]), points).sample(np.array([0.5]))
    assert between.tolist() == [0, 0, 0, 180, 0, 180, 1]
    assert unwrap_rotations(PoseType.P, points)[1, 3:6].tolist() == [181, 0, -190]
    assert unwrap_rotations(PoseType.J, points) is points


def test_rotations_beyond_half_a_turn_are_left_there() -> None:
    points = np.array([[0, 0, 0, 179.0, 0, 0, 1], [0, 0, 0, 183.0, 0, 0, 1]])
    (between,) = SmoothCurve(PoseType.P, np.array([0.0, 1.0]), points).sample(np.array([0.75]))
    assert between[3] == pytest.approx(182, abs=0.5)


def test_fig_has_nothing_between() -> None:
    points = np.array([[0, 0, 0, 0, 0, 0, 1.0], [1, 0, 0, 0, 0, 0, 5.0]])
    found = SmoothCurve(PoseType.P, np.array([0.0, 1.0]), points).sample(np.array([0.0, 0.5, 0.99, 1.0]))
    assert found[:, 6].tolist() == [1, 1, 1, 5]


def test_directions_stay_unit_vectors_at_a_right_angle() -> None:
    turned = [[0, 0, 0, np.cos(a), np.sin(a), 0, 0, 0, 1, 1] for a in np.linspace(0, 2, 8)]
    found = SmoothCurve(PoseType.T, np.arange(8.0), np.array(turned)).sample(np.linspace(0, 7, 90))
    orientation, approach = found[:, 3:6], found[:, 6:9]
    assert np.linalg.norm(orientation, axis=1) == pytest.approx(np.ones(90))
    assert np.linalg.norm(approach, axis=1) == pytest.approx(np.ones(90))
    assert (orientation * approach).sum(axis=1) == pytest.approx(np.zeros(90), abs=1e-12)


def test_a_smooth_motion_is_met_closely() -> None:
    coarse, fine = swing(period=0.04), swing()
    curve = SmoothCurve(PoseType.J, np.arange(float(len(coarse))) * 0.04, coarse)
    found = curve.sample(np.arange(float(len(fine))) * 0.008)
    assert np.abs(found - fine).max() < 0.05
