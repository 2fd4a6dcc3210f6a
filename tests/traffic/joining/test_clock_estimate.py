"""The difference of two clocks, from the frames that both places captured."""

from __future__ import annotations

import random

import pytest

from bcapscope.traffic.joining.clock_estimate import ClockEstimate, ClockEstimator

MS = 1_000_000
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND

Bounds = list[tuple[int, int]]
"""Times of frames and the bounds that they give for the offset, in ns."""


def estimated(
    offset: int, drift: float, seconds: int, seed: int = 1, *, bend: float = 0.0
) -> tuple[ClockEstimate, int]:
    """Return an estimate, and the largest error of the offset over the whole time."""
    chance = random.Random(seed)
    estimator = ClockEstimator()

    def by_controller(time: int) -> int:
        elapsed = time - START
        return time + offset + round(elapsed * drift + bend * elapsed * elapsed / SECOND)

    times = range(START, START + seconds * SECOND, 100 * MS)
    for sent in times:
        arrived = sent + round(chance.expovariate(1 / (0.2 * MS))) + 50_000
        replied = arrived + MS
        received = replied + round(chance.expovariate(1 / (0.2 * MS))) + 50_000
        estimator.add_frame(sent, by_controller(arrived), is_request=True)
        estimator.add_frame(received, by_controller(replied), is_request=False)
    estimate = estimator.estimate()
    assert estimate is not None
    return estimate, max(abs(estimate.to_client_clock(by_controller(time)) - time) for time in times)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("offset", [0, -3 * MS, 120 * SECOND])
@pytest.mark.parametrize(("drift", "seconds"), [(0.0, 3), (50e-6, 120), (-100e-6, 3600)])
def test_the_truth_is_within_the_uncertainty(offset: int, drift: float, seconds: int, seed: int) -> None:
    estimate, worst = estimated(offset, drift, seconds, seed)
    assert worst <= estimate.error + 1000
    assert estimate.error < MS
    if drift:
        assert estimate.drift == pytest.approx(drift, abs=5e-6)
    else:
        assert estimate.drift is None


def test_a_drift_that_changes_is_followed() -> None:
    estimate, worst = estimated(5 * MS, 0.0, 1800, bend=2e-8)
    assert len(estimate.points) > 2
    assert worst <= estimate.error + 200_000


def test_without_common_frames_there_is_no_estimate() -> None:
    assert ClockEstimator().estimate() is None


def estimate_of(requests: Bounds, replies: Bounds) -> ClockEstimate | None:
    """Estimate from the upper bounds that requests give, and the lower bounds that replies give."""
    estimator = ClockEstimator()
    for bounds, is_request in ((requests, True), (replies, False)):
        for time, offset in bounds:
            estimator.add_frame(time - offset, time, is_request=is_request)
    return estimator.estimate()


EXACT: dict[str, tuple[Bounds, Bounds, ClockEstimate]] = {
    "the middle between two bounds": (
        [(START, 200)],
        [(START + 10, 100)],
        ClockEstimate(((START, 150), (START + 10, 150)), 51),
    ),
    "the reply is captured first": (
        [(START + 10, 200), (START + 20, 200), (START + 30, 200)],
        [(START, 100), (START + 20, 100)],
        ClockEstimate(((START, 150), (START + 30, 150)), 51),
    ),
    "no frame is delayed": ([(START, 100)], [(START, 100)], ClockEstimate(((START, 100),), 1)),
    "the lowest upper bound of one time counts": (
        [(START, 300), (START, 200), (START, 400)],
        [(START, 100)],
        ClockEstimate(((START, 150),), 51),
    ),
    "a frame out of order does not count": (
        [(START, 200), (START + 20, 200), (START + 10, 180)],
        [(START, 100)],
        ClockEstimate(((START, 150), (START + 20, 150)), 51),
    ),
    "requests alone": ([(START, 300), (START + 10, 200)], [], ClockEstimate(((START + 10, 200),), SECOND)),
    "replies alone": ([], [(START, 100), (START + 10, 200)], ClockEstimate(((START + 10, 200),), SECOND)),
    "the clock is set forward": (
        [(START, 41), (START + 10 * SECOND, 50 * MS), (START + 20 * SECOND, 50 * MS)],
        [(START + 9 * SECOND, 0), (START + 10 * SECOND, 50 * MS - 20)],
        ClockEstimate(((START + 4500 * MS, 20), (START + 10 * SECOND, 50 * MS - 10)), 21),
    ),
    "the clock is set forward by less than the delays differ": (
        [(START, 0), (START + SECOND, 50 * MS)],
        [(START, -10), (START + SECOND, 50 * MS)],
        ClockEstimate(((START + SECOND // 2, 25 * MS),), 25 * MS),
    ),
    "the clock is set forward between requests and replies": (
        [(START, 7), (START + SECOND, 5)],
        [(START + 10 * SECOND, 50 * MS)],
        ClockEstimate(((START, 7),), SECOND),
    ),
}


@pytest.mark.parametrize("name", EXACT)
def test_bounds_determine_the_estimate(name: str) -> None:
    requests, replies, expected = EXACT[name]
    assert estimate_of(requests, replies) == expected


@pytest.mark.parametrize("offset", [0, 3 * SECOND, -3 * SECOND])
@pytest.mark.parametrize(
    ("upper", "ends"),
    [((100_000, 10_000, 5_000), (10_000, 2_500)), ((5_000, 10_000, 100_000), (2_500, 10_000))],
)
def test_a_quick_request_in_the_middle_narrows_both_ends(
    upper: tuple[int, ...], ends: tuple[int, int], offset: int
) -> None:
    times = range(START, START + 30 * SECOND, 10 * SECOND)
    estimate = estimate_of(
        [(time, offset + bound) for time, bound in zip(times, upper, strict=True)],
        [(time, offset) for time in times],
    )
    assert estimate is not None
    assert estimate.error == pytest.approx(10_000, abs=2)
    assert [each - offset for _, each in estimate.points] == pytest.approx(ends, abs=2)


def test_the_offset_changes_linearly_between_and_beyond_the_points() -> None:
    estimate = ClockEstimate(((0, 0), (10, 100), (20, 0)), 1)
    assert [estimate.offset_at(time) for time in (-5, 0, 5, 10, 15, 20, 25)] == [-50, 0, 50, 100, 50, 0, -50]


def test_a_single_point_is_the_offset_at_all_times() -> None:
    estimate = ClockEstimate(((START, 7),), SECOND)
    assert [estimate.to_client_clock(time) for time in (START - 10, START, START + 10)] == [
        START - 17,
        START - 7,
        START + 3,
    ]


def test_a_steady_drift_is_found_over_a_whole_day() -> None:
    frames = [(START + index * 1000 * SECOND, index * 50 * MS) for index in range(87)]
    estimate = estimate_of([(time, offset + 100) for time, offset in frames], frames)
    assert estimate is not None
    assert estimate.drift == pytest.approx(50e-6, abs=1e-11)
    assert estimate.error == pytest.approx(50, abs=2)


def test_the_drift_is_the_middle_of_what_the_bounds_allow() -> None:
    later = START + 100_000
    estimate = estimate_of([(START, 0), (later, 20)], [(START, 0), (later, 10)])
    assert estimate is not None
    assert estimate.drift == pytest.approx(150e-6, abs=1e-6)


def test_copies_of_a_capture_have_no_offset_and_no_uncertainty() -> None:
    frames = [(START + index * SECOND, 0) for index in range(3600)]
    estimate = estimate_of(frames, frames)
    assert estimate is not None
    assert estimate.error == 0
    assert {offset for _, offset in estimate.points} == {0}


@pytest.mark.parametrize(("ppm", "is_steady"), [(199, True), (-199, True), (201, False), (-201, False)])
def test_clocks_of_computers_drift_by_at_most_200_ppm(ppm: int, is_steady: bool) -> None:
    frames = [(START + index * SECOND, index * ppm * 1000) for index in range(100)]
    estimate = estimate_of([(time, offset + 100) for time, offset in frames], frames)
    assert estimate is not None
    assert estimate.drift == (pytest.approx(ppm * 1e-6, abs=1e-8) if is_steady else None)
    assert len(estimate.points) == (2 if is_steady else 10)
