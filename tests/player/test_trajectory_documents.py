"""Trajectories as objects: bcapscope's own JSON and messages of ROS."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.messages import Message
from bcapscope.player.column_layout import ReadOptions
from bcapscope.player.trajectory import Trajectory, TrajectoryError, TrajectorySource
from bcapscope.player.trajectory_documents import EXTRACT_FORMAT, read_documents
from bcapscope.protocol.slave_mode.modes import PoseType
from tests.player.ways import texts

JSON = TrajectorySource("way.json", Message.from_table("text", "JSON"))


def message(names: list[str], *points: tuple[object, object]) -> dict[str, Any]:
    return {
        "joint_names": names,
        "points": [{"positions": positions, "time_from_start": time} for positions, time in points],
    }


def own(**changes: object) -> dict[str, Any]:
    plain = {
        "format": EXTRACT_FORMAT,
        "stay": 3,
        "interval_ms": 8.0,
        "columns": ["time_s", "J1_deg", "J2_deg", "returned_J1_deg", "returned_J2_deg"],
        "rows": [[0.0, 1.0, 2.0, 0.9, None], [0.008, 1.5, 2.5, None, None]],
    }
    return {**plain, **changes}


def read(*documents: object, wishes: ReadOptions | None = None) -> tuple[Trajectory, ...]:
    return read_documents(documents, JSON, wishes or ReadOptions())


@pytest.mark.parametrize(
    ("times", "period"),
    [
        ([{"sec": 0, "nanosec": 0}, {"sec": 0, "nanosec": 500_000_000}], 0.5),
        ([{"secs": 1, "nsecs": 0}, {"secs": 3, "nsecs": 500_000_000}], 2.5),
        ([{"sec": "0", "nanosec": "0"}, {"sec": "1", "nanosec": "0"}], 1.0),
        ([0, 0.25], 0.25),
        ([None, None], None),
        (["null", "~"], None),
        ([{"sec": 0}, {"sec": "soon"}], None),
    ],
)
def test_durations(times: list[object], period: float | None) -> None:
    (trajectory,) = read(message(["a", "b"], *(([0, 1], time) for time in times)))
    assert trajectory.period == period


def test_radians_become_degrees() -> None:
    (trajectory,) = read(message(["j1", "j2"], ([math.pi, "-1.5"], 0)))
    assert trajectory.points[0].tolist() == pytest.approx([180.0, math.degrees(-1.5)])
    assert "radians were converted to degrees" in texts(trajectory.source.notes)
    assert trajectory.source.columns[0].unit == "rad"


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["joint_2", "joint_1"], [2.0, 1.0]),
        (["arm1_joint_1_link", "arm1_joint_2_link"], [1.0, 2.0]),
        (["elbow", "shoulder"], [1.0, 2.0]),
        (["joint_0", "joint_1"], [1.0, 2.0]),
        (["joint_11", "joint_12"], [1.0, 2.0]),
        (["J1", "gripper"], [1.0]),
        (["a1", "b1"], [1.0, 2.0]),
    ],
)
def test_joints_are_told_by_their_numbers(names: list[str], order: list[float]) -> None:
    (trajectory,) = read(message(names, ([math.radians(1), math.radians(2)], 0)))
    assert trajectory.points[0].tolist() == pytest.approx(order)


def test_messages_that_lie_deeper() -> None:
    one, two = message(["a"], ([1], 0)), message(["a"], ([2], 0))
    found = read({"goal": {"trajectory": one}}, [{"joint_trajectory": two}])
    assert [str(trajectory.source.part) for trajectory in found] == ["trajectory 1", "trajectory 2"]


def test_what_is_referred_to_often_is_looked_at_once() -> None:
    node: list[object] = [message(["a"], ([1], 0))]
    for _ in range(7):
        node = [node] * 1000
    node.append(node)
    assert len(read(node)) == 1


def test_what_extract_wrote() -> None:
    (trajectory,) = read(own())
    assert trajectory.points.tolist() == [[1, 2], [1.5, 2.5]]
    assert (trajectory.period, trajectory.times) == (0.008, None)
    assert str(trajectory.source.part) == "slave-mode session 3"
    (trajectory,) = read(own(rows=[[0, "NaN", "-Infinity", None, None]], interval_ms=None))
    assert str(trajectory.points.tolist()) == "[[nan, -inf]]"
    assert trajectory.period is None


@pytest.mark.parametrize(
    ("document", "error"),
    [
        ({}, "there is no trajectory in it"),
        ([1, 2], "there is no trajectory in it"),
        ("text", "there is no trajectory in it"),
        ({"foo": 1}, "there is no trajectory in it: no joint_names with points, only foo"),
        (message([]), "joint_names is not a list of names"),
        (message([1]), "joint_names is not a list of names"),  # type: ignore[list-item]
        (message(["a"]), "0 points are not a trajectory"),
        (message(["a"], ([1, 2], 0)), "point 1 has no positions for 1 joints"),
        (message(["a"], ([1], 0), (None, 0)), "point 2 has no positions for 1 joints"),
        (message(["a"], ([1], 0), ([1], None), ([1], 2)), "point 2 has no time_from_start, but others have"),
        (message(["joint_3", "joint_4"], ([0, 0], 0)), "the joints are named J3, J4, but must be numbered"),
        (message(["a"], ([[]], 0)), "set point 1: list is not a number for J1"),
        (message(["a"], (["x" * 90], 0)), f"set point 1: '{'x' * 40}' is not a number for J1"),
        (message(["a"], ([True], 0)), "set point 1: bool is not a number for J1"),
        (message(list("abcdefghi"), ([0] * 9, 0)), "9 joints, and no numbers in their names"),
        (own(columns=None), "columns is not a list of names"),
        (own(columns=["a"]), "no columns of a pose among these: a"),
        (own(rows=[]), "rows is not a list of set points"),
        (own(rows=[[0]]), "set point 1 is not a list of 5 values"),
        (own(rows=[[0, None, 1, 1, 1]]), "set point 1: NoneType is not a number for J1"),
    ],
)
def test_what_is_none(document: object, error: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        read(document)
    assert str(caught.value).startswith(error)


def test_joints_are_no_positions() -> None:
    with pytest.raises(TrajectoryError, match="not type P"):
        read(message(["a"], ([1], 0)), wishes=ReadOptions(PoseType.P))


THINGS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["joint_names", "points", "positions", "time_from_start", "sec"]), inner
        )
    ),
    max_leaves=30,
)


@given(THINGS | st.builds(message, st.lists(st.text(max_size=4)), st.tuples(st.lists(THINGS), THINGS)))
def test_any_object_gives_trajectories_or_one_error(document: object) -> None:
    try:
        trajectories = read(document)
    except TrajectoryError:
        return
    assert all(len(each) for each in trajectories)


@given(
    st.fixed_dictionaries(
        {"format": st.just(EXTRACT_FORMAT), "columns": THINGS, "rows": THINGS, "interval_ms": THINGS}
    )
)
def test_any_object_that_claims_to_be_ours(document: object) -> None:
    with pytest.raises(TrajectoryError):
        read(document)
