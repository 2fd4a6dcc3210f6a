"""Trajectories: shapes, what is filled in, what errors say."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.player.ways import way


def test_axes_are_those_of_the_columns() -> None:
    assert [axis.name for axis in way([[1, 2, 3]]).axes] == ["J1", "J2", "J3"]
    assert [axis.name for axis in way([[0] * 7], PoseType.P).axes][-1] == "Fig"
    assert len(way([[0] * 6] * 4)) == 4


def test_points_cannot_be_changed() -> None:
    trajectory = way([[1.0]], times=[0.0])
    with pytest.raises(ValueError, match="read-only"):
        trajectory.points[0, 0] = 2.0
    assert trajectory.times is not None
    with pytest.raises(ValueError, match="read-only"):
        trajectory.times[0] = 2.0


@pytest.mark.parametrize(
    ("kind", "present", "filled"),
    [
        (PoseType.J, (), (1, 2, 3, 4, 5, 6, 0, 0)),
        (PoseType.J, (9, 9, 9, 9, 9, 9, 7, 8), (1, 2, 3, 4, 5, 6, 7, 8)),
        (PoseType.J, (9, 9, 9, 9, 9, 9, 7), (1, 2, 3, 4, 5, 6, 7, 0)),
        (PoseType.P, (), (1, 2, 3, 4, 5, 6, 0)),
        (PoseType.P, (9, 9, 9, 9, 9, 9, 5), (1, 2, 3, 4, 5, 6, 5)),
    ],
)
def test_axes_that_are_not_in_the_file_stay_where_they_are(
    kind: PoseType, present: tuple[float, ...], filled: tuple[float, ...]
) -> None:
    trajectory = way([[1, 2, 3, 4, 5, 6]] * 2, kind)
    assert trajectory.completed(present).points.tolist() == [list(filled)] * 2
    assert trajectory.completed(present).set_point(1) == filled


def test_what_is_whole_stays_as_it_is() -> None:
    trajectory = way(np.arange(16.0).reshape(2, 8))
    assert trajectory.completed((5,) * 8).points.tolist() == trajectory.points.tolist()


@pytest.mark.parametrize(
    ("points", "kind"),
    [
        (np.zeros((0, 6)), PoseType.J),
        (np.zeros((2, 0)), PoseType.J),
        (np.zeros((2, 9)), PoseType.J),
        (np.zeros((2, 5)), PoseType.P),
        (np.zeros((2, 8)), PoseType.P),
        (np.zeros((2, 8)), PoseType.T),
        (np.zeros(6), PoseType.J),
    ],
)
def test_shapes_that_are_no_poses(points: Array, kind: PoseType) -> None:
    with pytest.raises(ValueError, match=r"(do not fit|a trajectory cannot have)"):
        way(points, kind)


def test_times_are_as_many_as_points() -> None:
    with pytest.raises(ValueError, match="times"):
        way([[1], [2]], times=[0.0])


def test_it_can_be_sent_to_another_process() -> None:
    trajectory = pickle.loads(pickle.dumps(way([[1, 2], [3, 4]], times=[0, 1])))
    assert trajectory.points.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("line", "column", "text"),
    [
        (None, None, "odd"),
        (3, None, "line 3: odd"),
        (3, 7, "line 3, column 7: odd"),
        (None, 7, "column 7: odd"),
    ],
)
def test_errors_tell_the_place(line: int | None, column: int | None, text: str) -> None:
    error = TrajectoryError(Message.from_table("text", "odd"), line, column)
    assert str(error) == text
    assert isinstance(error, BcapError)
    assert isinstance(error, ValueError)
