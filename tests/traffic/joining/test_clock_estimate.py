"""The difference of two clocks, from the frames that both places captured."""

from __future__ import annotations

import random

import pytest

from bcapscope.traffic.joining.clock_estimate import ClockEstimate, ClockEstimator

MS = 1_000_000
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def estimated(
    offset: int, drift: float, seconds: int, seed: int = 1, *, replies: bool = True, bend: float = 0.0
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
        if replies:
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


def test_requests_alone_bound_the_offset_from_one_side_only() -> None:
    estimate, _ = estimated(MS, 0.0, 3, replies=False)
    assert estimate.error == 1_000_000_000


def test_without_common_frames_there_is_no_estimate() -> None:
    assert ClockEstimator().estimate() is None
