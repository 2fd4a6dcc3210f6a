"""The row of set points: held ends, rounds, and coming to rest."""

from __future__ import annotations

from itertools import islice, pairwise

import numpy as np
import pytest

from bcapscope.player.arm_limits import UNKNOWN_ARM
from bcapscope.player.set_point_sequence import SetPointSequence
from bcapscope.player.trajectory import Trajectory, TrajectorySource
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.player.simulated import wave

PERIOD = 0.008


def course(points: int = 200, rounds: int = 1, hold: int = 2) -> SetPointSequence:
    """Make one."""
    trajectory = Trajectory(PoseType.J, np.array(wave(points, 20.0)), TrajectorySource(""))
    return SetPointSequence(trajectory, PERIOD, UNKNOWN_ARM, rounds, hold)


def first_axis(found: list[tuple[float, ...]]) -> list[float]:
    """Return J1 of points."""
    return [point[0] for point in found]


@pytest.mark.parametrize("rounds", [1, 3])
def test_each_round_follows_the_last_and_the_ends_are_held(rounds: int) -> None:
    made = course(rounds=rounds)
    found = first_axis(list(made))
    way = first_axis(wave(200, 20.0))
    assert found == [way[0]] * 2 + way * rounds + [way[-1]] * 2
    assert (made.index, made.total) == (200 * rounds, 200 * rounds)


def test_there_may_be_no_end() -> None:
    made = course(rounds=0)
    assert len(list(islice(made, 5000))) == 5000
    assert (made.index, made.total) == (4998, 0)


@pytest.mark.parametrize("sent", [3, 60, 100, 180, 201, 203])
@pytest.mark.parametrize("rounds", [1, 2, 0])
def test_it_comes_to_rest_without_a_jerk(sent: int, rounds: int) -> None:
    made = course(rounds=rounds)
    before = list(islice(made, sent))
    made.stop()
    made.stop()
    found = first_axis(before + list(made))
    steps = [b - a for a, b in pairwise(found)]
    assert steps[-2:] == [0, 0]
    assert max(abs(b - a) for a, b in pairwise(steps)) < 0.08
    assert len(found) - sent < 200


def test_a_stop_before_anything_moved_ends_at_once() -> None:
    made = course()
    next(made)
    made.stop()
    assert list(made) == []
    assert made.is_stopping
