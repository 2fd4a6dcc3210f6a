"""Other times for the same way: ends stay, nothing is faster than asked, and it begins and ends at rest."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.messages import Message
from bcapscope.player.arm_limits import SIMULATED_ARM, ArmLimits, limit_excess
from bcapscope.player.resampling import DEFAULT_RAMP, resample, stop_after
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import MAX_POINTS, Trajectory, TrajectoryError
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.simulator.kinematics import AxisLimit
from tests.player.ways import PERIOD, swing, texts, way

GENTLE = ArmLimits(
    Message("arm.unknown"), {f"J{axis}": AxisLimit(-360, 360, 200, 1500) for axis in range(1, 9)}
)


@st.composite
def ways(draw: st.DrawFn) -> Trajectory:
    axes = draw(st.integers(1, 3))
    row = st.lists(st.floats(-90, 90), min_size=axes, max_size=axes)
    points = draw(st.lists(row, min_size=2, max_size=15))
    period = draw(st.sampled_from([0.001, 0.004, 0.008, 0.01, 0.1]))
    if draw(st.booleans()):
        return way(points, period=period)
    steps = draw(st.lists(st.floats(1e-3, 1), min_size=len(points) - 1, max_size=len(points) - 1))
    return way(points, period=None, times=[0, *np.cumsum(steps).tolist()])


def steps_per_second(trajectory: Trajectory) -> float:
    knots = (
        trajectory.times
        if trajectory.times is not None
        else np.arange(float(len(trajectory))) * (trajectory.period or 0)
    )
    return float((np.abs(np.diff(trajectory.points, axis=0)) / np.diff(knots)[:, None]).max())


@given(ways(), st.sampled_from([0.25, 1.0, 2.0]), st.sampled_from([0.0, 0.05, DEFAULT_RAMP]))
def test_ends_stay_and_speed_is_bounded(trajectory: Trajectory, speed: float, ramp: float) -> None:
    found = resample(trajectory, PERIOD, speed=speed, ramp=ramp)
    assert found.points[0].tolist() == trajectory.points[0].tolist()
    assert found.points[-1].tolist() == trajectory.points[-1].tolist()
    assert (found.period, found.times, found.kind) == (PERIOD, None, trajectory.kind)
    bound = 1.75 if trajectory.period else 4.0  # where times are uneven a slope may count for a longer piece
    assert steps_per_second(found) <= bound * speed * steps_per_second(trajectory) * (1 + 1e-9) + 1e-6


@given(ways(), st.sampled_from([0.5, 1.0]))
def test_both_ends_are_at_rest(trajectory: Trajectory, speed: float) -> None:
    found = resample(trajectory, 0.001, speed=speed, ramp=0.1)
    speeds = np.abs(np.diff(found.points, axis=0)) / 0.001
    top = 1.75 * steps_per_second(trajectory)
    assert speeds[0].max() <= 0.001 * top + 1e-6
    assert speeds[-1].max() <= 0.001 * top + 1e-6


def test_the_same_times_give_the_same_points() -> None:
    trajectory = way(swing())
    assert np.array_equal(resample(trajectory, PERIOD, ramp=0).points, trajectory.points)


@pytest.mark.parametrize(("speed", "seconds"), [(1.0, 2.0), (0.5, 4.0), (2.0, 1.0)])
def test_speed_stretches_time(speed: float, seconds: float) -> None:
    found = resample(way(swing()), PERIOD, speed=speed, ramp=0)
    assert (len(found) - 1) * PERIOD == pytest.approx(seconds)
    assert (len(resample(way(swing()), PERIOD, speed=speed)) - 1) * PERIOD == pytest.approx(
        seconds + DEFAULT_RAMP, abs=PERIOD
    )


def test_another_interval_is_the_same_motion() -> None:
    found = resample(way(swing(period=0.02), period=0.02), PERIOD, ramp=0)
    assert np.abs(found.points - swing()).max() < 0.01


def test_without_an_interval_a_point_is_a_cycle() -> None:
    assert len(resample(way(swing(), period=None), PERIOD, ramp=0)) == len(swing())


def test_a_single_point_stays_one() -> None:
    found = resample(way([[1, 2]], period=None), PERIOD)
    assert (found.points.tolist(), found.period) == ([[1, 2]], PERIOD)


def test_what_was_done_is_noted() -> None:
    found = resample(way(swing()), PERIOD, speed=0.5)
    assert texts(found.source.notes) == ("resampled to 8 ms at 0.5 of the speed, 0.25 s to start and stop",)
    found = resample(way([[0]] * 5, period=None, times=[0, 0.01, 0.02, 0.5, 0.51]), PERIOD)
    assert (
        texts(found.source.notes)[-1] == "1 gap in the times; the longest is 480 ms, filled by a smooth curve"
    )


def test_an_interval_that_was_assumed_is_noted() -> None:
    found = resample(way([[0], [1], [2]], period=None), 0.008)
    assert texts(found.source.notes)[0] == "the file does not give the interval; 8 ms is assumed"


@pytest.mark.parametrize(
    ("trajectory", "error"),
    [
        (way([[0], [float("nan")]]), "set point 2 is not finite"),
        (way([[0], [float("inf")]]), "set point 2 is not finite"),
        (way([[0], [1], [2]], period=None, times=[0, 1, 1]), "the time of set point 3 is not later"),
        (way([[0], [1]], period=None, times=[0, float("nan")]), "the time of set point 2 is not later"),
        (way([[0], [1]], period=1e9), "are too many set points"),
        (way([[0], [1]], period=PERIOD * MAX_POINTS), "are too many set points"),
    ],
)
def test_what_cannot_be_resampled(trajectory: Trajectory, error: str) -> None:
    with pytest.raises(TrajectoryError, match=error):
        resample(trajectory, PERIOD)


@pytest.mark.parametrize(
    "odd",
    [
        {"speed": 0.0},
        {"speed": float("nan")},
        {"speed": 1e-12},
        {"ramp": -1.0},
        {"ramp": 1e9},
        {"period": 0.0},
    ],
)
def test_wishes_that_make_no_sense(odd: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"numbers above 0 are needed|too many set points"):
        resample(way(swing()), **{"period": PERIOD, **odd})


def stopped(trajectory: Trajectory, row: int, limits: ArmLimits, loop: bool = False) -> Array:
    """Return all that is sent when a stop is asked after a row, and the rest at its end."""
    stop = stop_after(trajectory, row, PERIOD, limits, loop=loop)
    return np.vstack((trajectory.points[: row + 1], stop, stop[-1:]))


@given(st.integers(1, 240), st.sampled_from([5.0, 20.0]), st.booleans())
def test_a_stop_ends_at_rest_within_the_limits(row: int, degrees: float, loop: bool) -> None:
    sent = stopped(way(swing(degrees=degrees)), row, GENTLE, loop)
    assert limit_excess(PoseType.J, sent, PERIOD, GENTLE) <= 1.0
    assert np.abs(sent[-1] - sent[-2]).max() == 0
    assert np.abs(sent[-2] - sent[-3]).max() < 0.02


@given(st.integers(1, 225))
def test_a_stop_stays_on_the_way(row: int) -> None:
    trajectory = way(swing()[:, :1].repeat(2, axis=1) * [1.0, 0.5])
    stop = stop_after(trajectory, row, PERIOD, GENTLE)
    assert stop[:, 1] == pytest.approx(stop[:, 0] / 2)
    passed = trajectory.points[row : row + len(stop) // 2 + 2, 0]
    assert passed.min() - 1e-9 <= stop[:, 0].min() <= stop[:, 0].max() <= passed.max() + 1e-9


def test_a_stop_takes_no_longer_than_it_must() -> None:
    trajectory = way(swing(degrees=60))
    assert len(stop_after(trajectory, 85, PERIOD, SIMULATED_ARM)) == 13
    assert 13 < len(stop_after(trajectory, 85, PERIOD, GENTLE)) < 40
    assert len(stop_after(trajectory, 85, PERIOD)) == 63


@pytest.mark.parametrize(("row", "count"), [(250, 0), (249, 1), (247, 3)])
def test_near_its_end_it_ends(row: int, count: int) -> None:
    trajectory = way(swing())
    assert stop_after(trajectory, row, PERIOD, GENTLE).tolist() == trajectory.points[row + 1 :].tolist()
    assert len(stop_after(trajectory, row, PERIOD, GENTLE)) == count


def test_a_loop_goes_on_behind_its_end() -> None:
    trajectory = way(np.vstack([swing(degrees=10)[:-1]] * 2)[60:310])
    stop = stop_after(trajectory, 245, PERIOD, GENTLE, loop=True)
    assert len(stop) > 10
    joined = np.vstack((trajectory.points[:246], stop, stop[-1:]))
    assert limit_excess(PoseType.J, joined, PERIOD, GENTLE) <= 1.0


def test_positions_stop_within_the_limits_of_joints() -> None:
    across = np.linspace(-200, 200, 200)
    points = np.stack([0 * across + 400, across, 0 * across + 500, *[0 * across] * 3, 0 * across + 1], axis=1)
    smooth = resample(way(points, PoseType.P), PERIOD)
    limits = SIMULATED_ARM
    stop = stop_after(smooth, 100, PERIOD, limits)
    sent = np.vstack((smooth.points[:101], stop, stop[-1:]))
    assert limit_excess(PoseType.P, sent, PERIOD, limits) <= 1.0
    assert stop[:, 6].tolist() == [1] * len(stop)


def test_a_stop_is_ready_before_the_next_set_point() -> None:
    trajectory = way(swing(degrees=20))
    stop_after(trajectory, 60, PERIOD, GENTLE)
    began = time.thread_time()
    for _ in range(5):
        stop_after(trajectory, 60, PERIOD, GENTLE)
    assert (time.thread_time() - began) / 5 < PERIOD
