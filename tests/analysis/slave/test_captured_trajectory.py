"""Trajectories: which set points are steps of them, and when."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.slave.captured_trajectory import (
    CapturedTrajectory,
    LeftOutReason,
    TrajectoryExtractor,
    TrajectoryStep,
)
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.tables.hresult import E_NOT_IN_SLAVE_MODE, E_SLAVE_UNDERFLOW
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Conversation
from tests.traffic.playbook import EXECUTE, MS, START, Script, i4, r8s, run_pipeline, text

ZERO = r8s(0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)


def change_mode(value: int) -> tuple[int, tuple[Variant, ...]]:
    return EXECUTE, (i4(1), text("slvChangeMode"), i4(value))


def receive_format(value: int, unit: int) -> tuple[int, tuple[Variant, ...]]:
    return EXECUTE, (i4(1), text("slvRecvFormat"), Variant.array(VT.I4, (value, unit)))


def move(pose: Variant) -> tuple[int, tuple[Variant, ...]]:
    return EXECUTE, (i4(1), text("slvMove"), pose)


def joints(first: float) -> Variant:
    return r8s(first, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)


def tell(
    script: Script,
    wanted: Callable[[Call], bool] | None = None,
    whose: Callable[[Conversation], bool] | None = None,
) -> tuple[list[tuple[CapturedTrajectory, list[TrajectoryStep]]], TrajectoryExtractor]:
    """Run all calls of a script through, and put the pieces of each trajectory together."""
    trajectories = TrajectoryExtractor(wanted, whose)
    run_pipeline(script.seen, trajectories)
    trajectories.finish()
    whole: dict[int, tuple[CapturedTrajectory, list[TrajectoryStep]]] = {}
    for trajectory, steps in trajectories.ready:
        whole.setdefault(trajectory.session_number, (trajectory, []))[1].extend(steps)
    return list(whole.values()), trajectories


def test_retries_are_one_step_with_the_time_of_the_first() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, change_mode(0x202))
    client.reply(1, 1)
    client.ask(10, 2, 0, move(joints(1.0)))
    client.ask(26, 3, 2, move(joints(1.0)))
    client.reply(27, 3, 0, 0, joints(0.5))
    client.ask(30, 4, 0, move(joints(2.0)))
    client.reply(31, 4, 0, 0, joints(1.5))
    ((trajectory, steps),), trajectories = tell(script)
    assert trajectory.start == START + 10 * MS
    assert trajectory.mode.value == 0x202
    assert trajectory.mode.pose_type is PoseType.J
    assert [axis.name for axis in trajectory.axes] == ["J1", "J2", "J3", "J4", "J5", "J6", "J7", "J8"]
    times = START + 10 * MS, START + 27 * MS
    assert steps[0] == (2, *times, 1, 0, joints(1.0).value, joints(0.5).value, None)
    assert [step.commanded[0] for step in steps] == [1.0, 2.0]
    assert trajectories.left_out == {}


def test_what_was_refused_is_no_step_and_is_counted() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, change_mode(0x202))
    client.reply(1, 1)
    for number in range(3):
        client.ask(10 + 8 * number, 10 + number, 0, move(joints(number)))
        client.reply(11 + 8 * number, 10 + number, 0, 0, joints(number))
    client.ask(100, 20, 0, move(joints(4)))
    client.reply(101, 20, 0, E_SLAVE_UNDERFLOW)
    client.ask(108, 21, 0, move(joints(5)))
    client.reply(109, 21, 0, E_NOT_IN_SLAVE_MODE)
    client.ask(116, 22, 0, move(joints(6)))
    client.ask(10_000, 23, 0, move(joints(7)))
    client.reply(10_001, 23, 0, E_NOT_IN_SLAVE_MODE)
    ((_, steps),), trajectories = tell(script)
    assert [step.commanded[0] for step in steps] == [0, 1, 2]
    assert trajectories.left_out == {LeftOutReason.REFUSED: 3, LeftOutReason.AFTER_END: 1}
    assert trajectories.set_points == 7


def test_a_set_point_without_a_reply_stays_a_step() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, move(joints(1)))
    client.reply(1, 1, 0, 0, joints(1))
    client.ask(8, 2, 0, move(joints(2)))
    client.ask(16, 3, 0, move(joints(3)))
    client.reply(17, 3, 0, 0, joints(3))
    ((_, steps),), trajectories = tell(script)
    assert [(step.commanded[0], step.hresult, step.reply_time) for step in steps] == [
        (1, 0, START + 1 * MS),
        (2, None, None),
        (3, 0, START + 17 * MS),
    ]
    assert steps[1].returned == ()
    assert trajectories.left_out == {}


def test_a_stay_that_began_before_begins_with_what_was_accepted() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, move(joints(1)))
    client.reply(1, 1, 0, E_NOT_IN_SLAVE_MODE)
    client.ask(8, 2, 0, move(joints(2)))
    client.reply(9, 2, 0, 0, joints(2))
    ((trajectory, steps),), trajectories = tell(script)
    assert trajectory.start == START + 8 * MS
    assert trajectory.mode.value is None
    assert [step.commanded[0] for step in steps] == [2]
    assert trajectories.left_out == {LeftOutReason.REFUSED: 1}


def test_each_stay_is_a_trajectory_of_its_own() -> None:
    script = Script()
    client = script.client()
    for stay in range(2):
        base, serial = stay * 100, stay * 10
        client.ask(base, serial + 1, 0, change_mode(0x202))
        client.reply(base + 1, serial + 1)
        client.ask(base + 10, serial + 2, 0, move(joints(stay)))
        client.reply(base + 11, serial + 2, 0, 0, joints(stay))
        client.ask(base + 20, serial + 3, 0, change_mode(0))
        client.reply(base + 21, serial + 3)
    found, _ = tell(script)
    assert [(trajectory.session_number, steps[0].commanded[0]) for trajectory, steps in found] == [
        (1, 0),
        (2, 1),
    ]


def test_time_stamps_are_in_milliseconds_whatever_they_count() -> None:
    for unit, stamp, expected in ((0, 4711, 4711.0), (1, 4711123, 4711.123)):
        script = Script()
        client = script.client()
        client.ask(0, 1, 0, receive_format(0x12, unit))
        client.reply(1, 1)
        client.ask(8, 2, 0, move(joints(1)))
        client.reply(9, 2, 0, 0, Variant.array(VT.VARIANT, (i4(stamp), joints(0.75))))
        ((trajectory, steps),), _ = tell(script)
        assert trajectory.has_stamps
        assert steps[0].stamp == expected
        assert steps[0].returned[0] == 0.75


def test_a_pose_that_does_not_fit_the_others_is_left_out() -> None:
    script = Script()
    client = script.client()
    for number, pose in enumerate((joints(1), text("?"), joints(3))):
        client.ask(8 * number, number + 1, 0, move(pose))
        client.reply(8 * number + 1, number + 1)
    ((_, steps),), trajectories = tell(script)
    assert [step.commanded[0] for step in steps] == [1, 3]
    assert trajectories.left_out == {LeftOutReason.UNREADABLE: 1}


def test_wishes() -> None:
    script = Script()
    for port in (50001, 50002):
        client = script.client(port)
        for number in range(4):
            client.ask(8 * number, number + 1, 0, move(joints(number)))
            client.reply(8 * number + 1, number + 1, 0, 0, joints(number))
    found, trajectories = tell(
        script, lambda call: call.request.time > START, lambda conversation: conversation.client.port == 50002
    )
    ((trajectory, steps),) = found
    assert trajectory.conversation.client.port == 50002
    assert [step.commanded[0] for step in steps] == [1, 2, 3]
    assert trajectories.set_points == 4
    assert trajectories.left_out == {LeftOutReason.NOT_SELECTED: 1}


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["accepted", "lost", "refused", "off", "unreadable", "retried"]),
            st.floats(allow_nan=False, allow_infinity=False),
        ),
        max_size=40,
    )
)
def test_every_set_point_is_a_step_or_left_out(story: list[tuple[str, float]]) -> None:
    script = Script()
    client = script.client()
    serial = 0
    for number, (fate, value) in enumerate(story):
        serial += 1
        pose = text("?") if fate == "unreadable" else joints(value)
        client.ask(8 * number, serial, 0, move(pose))
        if fate == "retried":
            client.ask(8 * number + 2, serial + 1, serial, move(pose))
            serial += 1
        codes = {"refused": E_SLAVE_UNDERFLOW, "off": E_NOT_IN_SLAVE_MODE}
        if fate != "lost":
            client.reply(8 * number + 3, serial, 0, codes.get(fate, 0))
    found, trajectories = tell(script)
    steps = [step for _, steps in found for step in steps]
    assert trajectories.set_points == len(story)
    assert len(steps) + sum(trajectories.left_out.values()) == len(story)
    assert trajectories.left_out.get(LeftOutReason.REFUSED, 0) == sum(
        fate in ("refused", "off") for fate, _ in story
    )
    accepted = [value for fate, value in story if fate in ("accepted", "retried")]
    assert [step.commanded[0] for step in steps if step.hresult == 0] == accepted
    assert len({step.call for step in steps}) == len(steps)
