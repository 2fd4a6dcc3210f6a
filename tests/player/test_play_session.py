"""The whole sequence against a simulator in memory, under a clock that jumps: nothing here takes time."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from math import nan

import pytest

from bcapscope.player import play_session
from bcapscope.player.play_session import AGAIN, CLEAR, YES
from bcapscope.player.player_messages import (
    ControllerInfo,
    Order,
    PlayEnded,
    PlayerProblem,
    PlayOutcome,
    PlayProgress,
    PlayState,
    QuestionTopic,
    SlaveModePacing,
    decode_message,
    encode_message,
)
from bcapscope.player.robot_adapter import RobotAdapter
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, pose_type_of_mode, slave_mode_by_number
from bcapscope.protocol.slave_mode.poses import pose_numbers
from bcapscope.simulator.machine import InitialState
from tests.player.simulated import HOME, MS, Stage, fall_silent, named, plan, wave


def set_points(stage: Stage) -> list[tuple[int, Frame]]:
    """Return all packets with set points, retries included."""
    return [(time, frame) for time, frame in stage.channel.sent if named(frame) == "slvMove"]


def first_axis(frame: Frame) -> float:
    """Return J1 of a set point."""
    row = frame.arguments[2].variant.value
    assert isinstance(row, tuple)
    assert isinstance(row[0], float)
    return row[0]


def speeds(stage: Stage) -> list[float]:
    """Return the steps of J1 between set points."""
    ways = [first_axis(frame) for _, frame in set_points(stage) if frame.reserved == 0]
    return [b - a for a, b in pairwise(ways)]


def order_after(stage: Stage, count: int, order: Order) -> None:
    """Give an order once so many packets with set points were sent."""
    stage.pipe.at_poll = lambda _: order if stage.channel.points > count else None


def test_rc8_is_led_through_the_sequence_and_left_as_it_was() -> None:
    stage = Stage()
    ended = stage.play(plan(0x102))
    assert (ended.outcome, str(ended.reason or ""), ended.left) == (PlayOutcome.DONE, "", True)
    assert stage.calls == [
        *("Service_Start", "Controller_Connect", "Controller_GetRobot", "TakeArm", "Motor"),
        *("slvSendFormat", "slvRecvFormat", "slvChangeMode 258", "slvMove", "slvChangeMode 0"),
        *("Motor", "GiveArm", "Robot_Release", "Controller_Disconnect", "Service_Stop"),
    ]
    assert not stage.simulator.machine.motor_is_on(stage.channel.now())


def test_rc7_has_robslave_started_and_stopped() -> None:
    stage = Stage("rc7")
    assert stage.play(plan(0x002)).outcome is PlayOutcome.DONE
    assert stage.calls == [
        *("Service_Start", "Controller_Connect", "Controller_GetRobot", "Controller_GetTask", "Task_Start"),
        *("Motor", "slvChangeMode 2", "slvMove", "slvChangeMode 0", "Motor", "Task_Stop"),
        *("Task_Release", "Robot_Release", "Controller_Disconnect", "Service_Stop"),
    ]
    assert set(stage.simulator.machine.tasks.values()) == {2}


def test_nothing_that_energises_the_robot_is_sent_before_the_start_is_confirmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    identify = RobotAdapter.identify

    async def switch_on_too_early(robot: RobotAdapter) -> None:
        await identify(robot)
        await robot.motor_on()

    monkeypatch.setattr(RobotAdapter, "identify", switch_on_too_early)
    stage = Stage()
    assert stage.play(plan(0x102)).outcome is PlayOutcome.UNARMED
    assert "Motor" not in stage.calls
    assert stage.calls[-1] == "Service_Stop"


def test_a_motor_that_was_on_stays_on() -> None:
    stage = Stage(start=InitialState(motor=True))
    assert stage.play(plan(0x202)).outcome is PlayOutcome.DONE
    assert "Motor" not in stage.calls
    assert stage.simulator.machine.motor_is_on(stage.channel.now())


def test_a_robot_that_somebody_else_moves_is_left_alone() -> None:
    stage = Stage(start=InitialState(motor=True))
    taken = slave_mode_by_number(0x202, Generation.RC8)
    assert taken is not None
    stage.simulator.machine.slave.enter(taken, stage.channel.now())
    ended = stage.play(plan(0x102))
    assert ended.outcome is PlayOutcome.DECLINED
    assert str(ended.reason or "").startswith("the robot is already in slave mode 0x202")
    assert stage.calls[2:] == [
        "Controller_GetRobot",
        "Robot_Release",
        "Controller_Disconnect",
        "Service_Stop",
    ]
    assert stage.simulator.machine.slave.mode is taken
    assert not stage.simulator.machine.active_alarms


def test_looking_changes_nothing() -> None:
    stage = Stage("rc7")
    assert stage.play(plan(0x002, look_only=True)).outcome is PlayOutcome.LOOKED
    (peer,) = [message for message in stage.pipe.messages if isinstance(message, ControllerInfo)]
    assert (peer.simulator, peer.generation, peer.pose, peer.distance) == (True, Generation.RC7, HOME, 0.0)
    assert peer.facts["type name"] == "BCAPSCOPE-SIM6"
    assert not {"Motor", "Task_Start", "slvMove"} & set(stage.calls)
    assert stage.pipe.asked == []


@pytest.mark.parametrize(
    ("profile", "mode"), [("rc7", 0x001), ("rc7", 0x002), ("rc8", 0x101), ("cserver", 0x102)]
)
def test_where_pose_variables_are_empty_commands_tell_the_pose(profile: str, mode: int) -> None:
    kind = PoseType(" PJT"[mode & 3])
    variables = ("@CURRENT_POSITION", "@CURRENT_ANGLE", "@CURRENT_TRANS", "@TYPE_NAME", "@SERVO_ON")
    usual, stage = Stage(profile), Stage(profile, InitialState(empty=variables))
    for each in (usual, stage):
        each.play(plan(mode, kind=kind, look_only=True))
    (known,) = [message for message in usual.pipe.messages if isinstance(message, ControllerInfo)]
    (peer,) = [message for message in stage.pipe.messages if isinstance(message, ControllerInfo)]
    assert peer.pose == known.pose
    assert peer.generation is known.generation
    assert "type name" not in peer.facts
    assert {"CurJnt", {PoseType.J: "CurJnt", PoseType.P: "CurPos"}[kind]} <= set(stage.calls)


def test_it_plays_where_pose_variables_are_empty() -> None:
    stage = Stage(start=InitialState(empty=("@CURRENT_ANGLE", "@CURRENT_POSITION")))
    ended = stage.play(plan(0x102))
    assert (ended.outcome, ended.left) == (PlayOutcome.DONE, True)
    assert stage.calls.count("CurJnt") >= 2


@pytest.mark.parametrize(
    ("profile", "mode", "expected"),
    [("rc7", 0x002, True), ("rc7", 0x102, False), ("rc8", 0x202, True), ("rc8", 0x102, False)],
)
def test_retries_are_expected_where_the_controller_sets_the_pace(
    profile: str, mode: int, expected: bool
) -> None:
    ended = Stage(profile).play(plan(mode))
    assert (ended.outcome, ended.retries_expected) == (PlayOutcome.DONE, expected)


@pytest.mark.parametrize(
    ("profile", "mode"), [("rc7", 0x002), ("rc7", 0x001), ("rc7", 0x003), ("rc8", 0x202), ("rc8", 0x002)]
)
def test_with_five_per_cent_lost_each_way_it_completes_and_nothing_runs_twice(
    profile: str, mode: int
) -> None:
    stage = Stage(profile, loss=0.05)
    kind = pose_type_of_mode(mode)
    points = wave(400, 2.0) if kind is PoseType.J else position_wave(str(kind))
    ended = stage.play(plan(mode, kind=kind, points=points, may_approach=True))
    assert (ended.outcome, str(ended.reason or "")) == (PlayOutcome.DONE, "")
    assert stage.simulator.machine.slave.consumed == ended.counts.sent - ended.counts.repeated
    assert ended.counts.retries > 10
    check_retries(stage)


def position_wave(kind: str) -> list[tuple[float, ...]]:
    """Make a small way of X there and back, from HOME."""
    first = (350.0, 0.0, 400.0, 0.0, 90.0, 0.0, 1.0)
    rest = first[1:] if kind == "P" else (0.0, 400.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0)
    return [(350.0 - (value[0]), *rest) for value in wave(400, 2.0)]


def check_retries(stage: Stage) -> Counter[int]:
    """Compare the tries with the slides: 2 ms apart, 7 after the first, the first serial in reserved.

    Returns:
        Retries of each set point by its first serial.
    """
    tries: Counter[int] = Counter()
    first = (0, 0)
    for time, frame in set_points(stage):
        if frame.reserved == 0:
            first = (frame.serial, time)
            continue
        number = tries[first[0]] = tries[first[0]] + 1
        assert frame.reserved == first[0]
        assert frame.serial == first[0] + number
        assert time - first[1] == number * 2 * MS
    assert max(tries.values()) <= 7
    return tries


def test_set_points_go_out_on_the_millisecond() -> None:
    stage = Stage()
    ended = stage.play(plan(0x102, points=wave(1000, 2.0), period=MS))
    times = [time for time, _ in set_points(stage)]
    assert {b - a for a, b in pairwise(times)} == {MS}
    assert (ended.lateness.most, ended.counts.retries, ended.counts.unanswered) == (0, 0, 0)


def test_async_goes_on_without_retries_when_packets_are_lost() -> None:
    stage = Stage(loss=0.05)
    ended = stage.play(plan(0x102, points=wave(1000, 2.0), period=MS))
    assert (ended.outcome, ended.counts.retries) == (PlayOutcome.DONE, 0)
    assert ended.counts.unanswered > 50
    assert all(frame.reserved == 0 for _, frame in set_points(stage))


def test_the_controller_sets_the_pace_where_it_waits() -> None:
    stage = Stage("rc8")
    stage.play(plan(0x202))
    firsts = [time for time, frame in set_points(stage) if frame.reserved == 0]
    assert {b - a for a, b in pairwise(firsts[8:])} == {8 * MS}


@pytest.mark.parametrize(
    ("profile", "mode"), [("rc7", 0x002), ("rc8", 0x202), ("rc8", 0x102), ("rc8", 0x002)]
)
def test_a_stop_brings_the_robot_to_rest_on_its_way(profile: str, mode: int) -> None:
    stage = Stage(profile)
    order_after(stage, 120, Order.STOP)
    ended = stage.play(plan(mode, points=wave(600, 40.0)))
    assert ended.outcome is PlayOutcome.STOPPED
    assert ended.left
    assert 30 < ended.index < 500
    steps = [abs(step) for step in speeds(stage)]
    assert max(steps) > 0.1
    assert steps[-1] == 0
    assert max(abs(b - a) for a, b in pairwise(steps)) < 0.1
    assert not stage.simulator.machine.active_alarms
    assert stage.calls[-5:] == [
        *(["Motor", "GiveArm"] if profile == "rc8" else ["Task_Stop", "Task_Release"]),
        *("Robot_Release", "Controller_Disconnect", "Service_Stop"),
    ]
    assert PlayState.STOPPING in [
        message.state for message in stage.pipe.messages if isinstance(message, PlayProgress)
    ]


def test_rounds_without_end_go_on_until_they_are_stopped() -> None:
    stage = Stage()
    order_after(stage, 1000, Order.STOP)
    ended = stage.play(plan(0x102, rounds=0))
    assert ended.outcome is PlayOutcome.STOPPED
    assert 1000 < ended.index < 1200
    assert max(map(abs, speeds(stage))) < 0.5


def test_a_halt_comes_before_everything_else() -> None:
    stage = Stage("rc7")
    order_after(stage, 120, Order.HALT)
    ended = stage.play(plan(0x002, points=wave(600, 40.0)))
    assert ended.outcome is PlayOutcome.HALTED
    place = stage.calls.index("Robot_Halt")
    assert stage.calls[place - 1 : place + 2] == ["slvMove", "Robot_Halt", "slvChangeMode 0"]
    assert stage.calls[-1] == "Service_Stop"
    halted = next(time for time, frame in stage.channel.sent if named(frame) == "Robot_Halt")
    assert halted - set_points(stage)[-1][0] <= 8 * MS


def test_the_motion_to_the_first_point_is_written_without_exponents() -> None:
    stage = Stage(start=InitialState(joints=(20.0, *HOME[1:])))
    points = [(6.1e-17, -3.2e-5, 90.0, -1e-7, 90.0, 1234.5e-3)] * 3
    stage.play(plan(0x202, points=points, may_approach=True))
    (move,) = [frame for _, frame in stage.channel.sent if named(frame) == "Robot_Move"]
    assert move.arguments[2].variant.value == "@E J(0, -0.000032, 90, 0, 90, 1.2345, 0, 0)"


def test_an_order_during_the_motion_to_the_first_point_halts_it() -> None:
    stage = Stage(start=InitialState(joints=(60.0, *HOME[1:])))
    stage.pipe.at_poll = lambda count: Order.STOP if "Robot_Move" in stage.calls else None
    assert stage.play(plan(0x202, may_approach=True)).outcome is PlayOutcome.STOPPED
    assert "slvMove" not in stage.calls
    assert stage.calls[stage.calls.index("Robot_Halt") :][:3] == ["Robot_Halt", "Motor", "GiveArm"]


@pytest.mark.parametrize("answer", ["yes", "no"])
def test_the_first_point_is_gone_to_if_the_user_agrees(answer: str) -> None:
    stage = Stage(start=InitialState(joints=(20.0, *HOME[1:])), answers={QuestionTopic.APPROACH: answer})
    ended = stage.play(plan(0x202))
    assert stage.pipe.asked == [QuestionTopic.BEGIN, QuestionTopic.APPROACH]
    if answer == "no":
        assert ended.outcome is PlayOutcome.DECLINED
        assert "Robot_Move" not in stage.calls
    else:
        assert ended.outcome is PlayOutcome.DONE
        (move,) = [frame for _, frame in stage.channel.sent if named(frame) == "Robot_Move"]
        texts = [argument.variant.value for argument in move.arguments[2:]]
        assert texts == ["@E J(0, 0, 90, 0, 90, 0, 0, 0)", "SPEED=10,NEXT"]
    assert stage.calls[-1] == "Service_Stop"


@pytest.mark.parametrize("answer", ["yes", "no"])
def test_another_posture_at_the_same_place_is_gone_to_as_well(answer: str) -> None:
    points = [(*row[:6], 5.0) for row in position_wave("P")]
    stage = Stage(answers={QuestionTopic.APPROACH: answer})
    ended = stage.play(plan(0x201, kind=PoseType.P, points=points))
    assert stage.pipe.asked == [QuestionTopic.BEGIN, QuestionTopic.APPROACH]
    assert ended.outcome is (PlayOutcome.DONE if answer == "yes" else PlayOutcome.DECLINED)
    assert ("Robot_Move" in stage.calls) is (answer == "yes")


def test_what_no_message_can_carry_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage(start=InitialState(type_name="arm \ud800"))
    slv_move = pose_numbers
    monkeypatch.setattr(play_session, "pose_numbers", lambda variant: (nan, *(slv_move(variant) or ())[1:]))
    assert stage.play(plan(0x202)).outcome is PlayOutcome.DONE
    for message in stage.pipe.messages:
        assert decode_message(encode_message(message)) == message


def test_a_controller_that_falls_silent_is_given_up() -> None:
    stage = Stage("rc7")
    fall_silent(stage, 99)
    ended = stage.play(plan(0x002))
    assert (ended.outcome, ended.left) == (PlayOutcome.UNANSWERED, False)
    tries = [frame for _, frame in set_points(stage)][-8:]
    assert len({frame.reserved for frame in tries[1:]}) == 1
    assert stage.calls[-1] == "slvChangeMode 0"


def test_in_async_silence_ends_it_too() -> None:
    stage = Stage()
    fall_silent(stage, 99)
    ended = stage.play(plan(0x102, points=wave(600)))
    assert ended.outcome is PlayOutcome.UNANSWERED
    assert 100 <= ended.index <= 120


def test_an_error_is_read_before_it_is_cleared() -> None:
    stage = Stage("rc7", answers={QuestionTopic.CLEAR: CLEAR})
    ended = stage.play(plan(0x002, points=[*wave()[:60], (90.0, *HOME[1:6])]))
    assert ended.outcome is PlayOutcome.REFUSED
    assert str(ended.reason or "").startswith("Robot_Execute slvMove was refused: 0x8")
    (trouble,) = [message for message in stage.pipe.messages if isinstance(message, PlayerProblem)]
    assert [hex(code)[:6] for code, _ in trouble.errors] == ["0x8420"]
    commands = [str(frame.arguments[1].variant.value) for _, frame in stage.channel.sent if frame.code == 17]
    assert commands == ["GetCurErrorCount", "GetCurErrorInfo", "ClearError"]
    assert not stage.simulator.machine.active_alarms
    assert stage.calls[-1] == "Service_Stop"


def test_an_error_on_the_way_to_the_first_point_is_read_and_clearing_offered() -> None:
    stage = Stage(start=InitialState(joints=(60.0, *HOME[1:])))
    machine = stage.simulator.machine

    def press(_: int) -> None:
        if "Robot_Move" in stage.calls and not machine.emergency:
            machine.press_emergency_stop(stage.channel.now())

    stage.pipe.at_poll = press
    ended = stage.play(plan(0x202, may_approach=True))
    assert ended.outcome is PlayOutcome.REFUSED
    assert str(ended.reason or "").startswith(
        "Robot_Move was refused: 0x8150101A, emergency stop is on; the robot is"
    )
    (trouble,) = [message for message in stage.pipe.messages if isinstance(message, PlayerProblem)]
    assert [code for code, _ in trouble.errors] == [0x8150101A]
    assert stage.pipe.asked == [QuestionTopic.BEGIN, QuestionTopic.CLEAR]


def test_an_error_is_left_where_nobody_wants_it_cleared() -> None:
    stage = Stage()
    assert stage.play(plan(0x202, points=[*wave()[:60], (90.0, *HOME[1:6])])).outcome is PlayOutcome.REFUSED
    assert stage.simulator.machine.active_alarms


def test_an_order_when_there_is_an_error_does_not_hide_it() -> None:
    stage = Stage()
    stage.pipe.at_poll = lambda _: Order.STOP if QuestionTopic.CLEAR in stage.pipe.asked else None
    assert stage.play(plan(0x202, points=[*wave()[:60], (90.0, *HOME[1:6])])).outcome is PlayOutcome.REFUSED
    assert stage.simulator.machine.active_alarms


def test_after_clearing_it_begins_again_with_robslave_and_the_first_point() -> None:
    stage = Stage("rc7", answers={QuestionTopic.CLEAR: AGAIN})
    pressed: list[bool] = []

    def press(_: int) -> None:
        if stage.channel.points > 150 and not pressed:
            pressed.append(True)
            stage.simulator.machine.press_emergency_stop(stage.channel.now())
            stage.simulator.machine.emergency = False

    stage.pipe.at_poll = press
    ended = stage.play(plan(0x002, may_approach=True))
    assert ended.outcome is PlayOutcome.DONE
    assert [name for name in stage.calls if name in ("Task_Start", "Robot_Move", "slvChangeMode 2")] == [
        *("Task_Start", "slvChangeMode 2", "Task_Start", "Robot_Move", "slvChangeMode 2")
    ]


def test_what_was_on_when_the_player_came_is_on_when_it_goes_errors_or_not() -> None:
    stage = Stage(start=InitialState(motor=True), answers={QuestionTopic.CLEAR: AGAIN})
    machine = stage.simulator.machine
    pressed: list[bool] = []

    def press(_: int) -> None:
        if stage.channel.points > 150 and not pressed:
            pressed.append(True)
            machine.press_emergency_stop(stage.channel.now())
            machine.emergency = False

    stage.pipe.at_poll = press
    assert stage.play(plan(0x202, may_approach=True)).outcome is PlayOutcome.DONE
    assert pressed
    assert machine.motor_is_on(stage.channel.now())


def test_clearing_is_offered_again_where_it_was_refused() -> None:
    stage = Stage(answers={QuestionTopic.CLEAR: CLEAR})
    machine = stage.simulator.machine

    def press(_: int) -> None:
        if stage.channel.points > 150 and not machine.active_alarms:
            machine.press_emergency_stop(stage.channel.now())
        if stage.pipe.asked.count(QuestionTopic.CLEAR) == 2:
            machine.emergency = False

    stage.pipe.at_poll = press
    assert stage.play(plan(0x202)).outcome is PlayOutcome.REFUSED
    assert stage.pipe.asked.count(QuestionTopic.CLEAR) == 2
    assert not machine.emergency


@pytest.mark.parametrize("armed", [True, False])
def test_a_real_controller_needs_arming(armed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.client.object_opener.SIMULATOR_TEXT", "what no simulator says")
    stage = Stage()
    ended = stage.play(plan(0x202, armed=armed))
    assert ended.outcome is (PlayOutcome.DONE if armed else PlayOutcome.UNARMED)
    assert ("TakeArm" in stage.calls) is armed
    assert stage.pipe.asked == ([QuestionTopic.BEGIN] if armed else [QuestionTopic.BEGIN, QuestionTopic.ARM])


def test_a_typed_confirmation_arms_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.client.object_opener.SIMULATOR_TEXT", "what no simulator says")
    assert Stage(answers={QuestionTopic.ARM: YES}).play(plan(0x202)).outcome is PlayOutcome.DONE


def test_a_mode_that_the_controller_lacks_is_said() -> None:
    ended = Stage("rc7").play(plan(0x202))
    assert (ended.outcome, str(ended.reason or "")) == (PlayOutcome.UNFIT, "RC7 has no slave mode 0x202")


def test_a_mode_of_another_pose_type_is_said() -> None:
    ended = Stage().play(plan(0x201))
    assert str(ended.reason or "") == "slave mode 0x201 takes P type, but the set points are of J type"


@pytest.mark.parametrize(
    ("profile", "pacing", "mode"),
    [
        *(("rc7", SlaveModePacing.SYNC, 2), ("rc8", SlaveModePacing.SYNC, 0x202)),
        *(("rc7", SlaveModePacing.ASYNC, 0x102), ("rc8", SlaveModePacing.ASYNC, 0x102)),
    ],
)
def test_the_number_of_a_mode_depends_on_the_generation(
    profile: str, pacing: SlaveModePacing, mode: int
) -> None:
    stage = Stage(profile)
    assert stage.play(plan(pacing)).outcome is PlayOutcome.DONE
    assert f"slvChangeMode {mode}" in stage.calls


def test_nobody_at_the_other_end() -> None:
    stage = Stage(loss=1.0)
    ended = stage.play(plan(0x202))
    assert isinstance(ended, PlayEnded)
    assert ended.outcome is PlayOutcome.UNANSWERED
    assert "Service_Start got no reply in time, 5 attempts" in str(ended.reason or "")


def test_the_log_of_the_controller_runs_during_the_motion() -> None:
    stage = Stage()
    assert stage.play(plan(0x202, log="anything")).outcome is PlayOutcome.DONE
    assert stage.session.has_log
    assert [name for name in stage.calls if "Log" in name or "slv" in name] == [
        *("ClearLog", "StartLog", "slvSendFormat", "slvRecvFormat", "slvChangeMode 514", "slvMove"),
        *("slvChangeMode 0", "StopLog"),
    ]
    assert len(stage.simulator.machine.log.records) > 120


@pytest.mark.parametrize(
    ("profile", "mode", "ms", "outcome"),
    [
        *(("rc7", 0x002, 6, PlayOutcome.DONE), ("rc7", 0x002, 10, PlayOutcome.REFUSED)),
        *(("rc8", 0x202, 20, PlayOutcome.DONE), ("rc8", 0x202, 40, PlayOutcome.REFUSED)),
    ],
)
def test_a_simulator_that_gets_no_processor_runs_out_of_set_points_before_it_asks_for_them(
    profile: str, mode: int, ms: int, outcome: PlayOutcome
) -> None:
    """Where the controller waits, its reply is what asks for the next set point.

    One that is held up for longer than its buffer lasts (one slot on RC7, three later) finds it empty when it
    goes on, before it has sent the reply that was due first. The player has sent each set point 0.3 ms after
    the reply before it, and filled the buffer at the beginning.
    """
    stage = Stage(profile)

    def hold_up(_: int) -> None:
        if stage.channel.points > 150 and stage.channel.asleep == (0, 0):
            now = stage.channel.now()
            stage.channel.asleep = (now, now + ms * MS)

    stage.pipe.at_poll = hold_up
    ended = stage.play(plan(mode))
    assert ended.outcome is outcome
    assert ended.counts.sent > 20
    assert ended.lateness.most == 0
    if outcome is PlayOutcome.REFUSED:
        assert "84201482" in str(ended.reason or "")
    for asked, sent in answered_and_next(stage):
        assert sent - asked <= 300_000 + stage.channel.delay


def answered_and_next(stage: Stage) -> list[tuple[int, int]]:
    """Return when each set point but the last was taken to be answered and when the next was sent."""
    firsts = [(time, frame.serial) for time, frame in set_points(stage) if frame.reserved == 0]
    heard = dict(stage.channel.heard)
    last_tries: dict[int, int] = {}
    for _, frame in set_points(stage):
        last_tries[frame.reserved or frame.serial] = frame.serial
    return [
        (heard[last_tries[serial]], next_time)
        for (_, serial), (next_time, _) in pairwise(firsts[8:])
        if last_tries[serial] in heard
    ]


def test_a_reply_that_is_longer_than_all_tries_is_waited_for() -> None:
    stage = Stage("rc8")

    def hold_up(_: int) -> None:
        stage.channel.delay = 7 * MS // 2 if 200 < stage.channel.points <= 210 else MS // 10

    stage.pipe.at_poll = hold_up
    ended = stage.play(plan(0x202, points=wave(200, 2.0)))
    assert (ended.outcome, str(ended.reason or "")) == (PlayOutcome.DONE, "")
    tries = check_retries(stage)
    assert tries.most_common(1)[0][1] == 7
    assert stage.simulator.machine.slave.consumed == ended.counts.sent
