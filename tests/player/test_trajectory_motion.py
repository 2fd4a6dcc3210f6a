"""Speeds and accelerations, and the share of an arm's limits that they take."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from bcapscope.player.arm_limits import SIMULATED_ARM, UNKNOWN_ARM, limit_excess, motions_of, with_limits
from bcapscope.protocol.slave_mode.modes import PoseType


def test_speeds_and_accelerations() -> None:
    (motion,) = motions_of(PoseType.J, np.array([[0.0], [1], [3], [3]]), 0.5, UNKNOWN_ARM)
    assert [axis.name for axis in motion.axes] == ["J1"]
    assert motion.speeds.tolist() == [[2], [4], [0]]
    assert motion.accelerations.tolist() == [[4], [-8]]


def test_fig_and_directions_have_no_speed() -> None:
    (motion,) = motions_of(PoseType.P, np.zeros((2, 7)), 1, UNKNOWN_ARM)
    assert [axis.name for axis in motion.axes] == ["X", "Y", "Z", "Rx", "Ry", "Rz"]
    (motion,) = motions_of(PoseType.T, np.zeros((2, 10)), 1, UNKNOWN_ARM)
    assert [axis.name for axis in motion.axes] == ["X", "Y", "Z"]


def test_rotations_go_on_through_half_a_turn() -> None:
    (motion,) = motions_of(
        PoseType.P, np.array([[0, 0, 0, 179.0, 0, 0], [0, 0, 0, -179.0, 0, 0]]), 1, UNKNOWN_ARM
    )
    assert motion.speeds[0, 3] == 2


def test_positions_move_the_joints_as_well() -> None:
    points = np.array([[350, 0, 750, 0, 90, 0, 1.0], [0, 350, 750, 0, 90, 0, 1], [900, 0, 0, 0, 0, 0, 1]])
    _, joints = motions_of(PoseType.P, points, 1, SIMULATED_ARM)
    assert len(joints.axes) == 6
    assert joints.rows[:2] == pytest.approx(np.array([[0, 0, 90, 0, 90, 0], [90, 0, 90, 0, 90, 0]]), abs=1e-9)
    assert np.isnan(joints.rows[2]).all()


@pytest.mark.parametrize(
    ("points", "share"),
    [
        ([[0], [0]], 0),
        ([[0], [1]], 0.5),
        ([[0], [1], [3]], 1.0),
        ([[0], [1], [-1]], 3.0),
        ([[5]], 0),
        ([[0], [float("nan")]], inf),
    ],
)
def test_the_share_of_the_limits(points: list[list[float]], share: float) -> None:
    limits = with_limits(UNKNOWN_ARM, ["J1.speed=2", "J1.acceleration=1"])
    assert limit_excess(PoseType.J, np.array(points, dtype=float), 1, limits) == share


def test_out_of_reach_is_beyond_every_limit() -> None:
    points = np.array([[350, 0, 750, 0, 90, 0], [9000, 0, 750, 0, 90, 0.0]])
    assert limit_excess(PoseType.P, points, 10, SIMULATED_ARM) == inf
