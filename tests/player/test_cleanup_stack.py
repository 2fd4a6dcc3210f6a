"""What was begun is ended: whatever is ordered and when, and by another player if there has to be one."""

from __future__ import annotations

import pytest

from bcapscope.player.player_messages import (
    CleanupTask,
    Order,
    PendingCleanup,
    PlayerProblem,
    PlayOutcome,
)
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.simulator.machine import InitialState
from tests.player.simulated import HOME, MS, SimulatedChannel, Stage, fall_silent, plan, wave


def order_at(stage: Stage, look: int, order: Order) -> None:
    """Give an order at the n-th look for one."""
    stage.pipe.at_poll = lambda count: order if count == look else None


@pytest.mark.parametrize("order", list(Order))
def test_an_order_ends_what_is_waited_for(order: Order) -> None:
    stage = Stage(start=InitialState(motor_time=10_000 * MS))
    stage.pipe.at_poll = lambda _: order if "Motor" in stage.calls else None
    ended = stage.play(plan(0x202))
    assert ended.outcome is (PlayOutcome.STOPPED if order is Order.STOP else PlayOutcome.HALTED)
    assert 10_000 * MS < stage.channel.now() < 12_000 * MS
    assert stage.calls[-5:] == ["Motor", "GiveArm", "Robot_Release", "Controller_Disconnect", "Service_Stop"]
    assert not stage.simulator.machine.motor_is_on(120_000 * MS)


@pytest.mark.parametrize("order", list(Order))
@pytest.mark.parametrize("profile", ["rc7", "rc8"])
def test_an_order_at_any_moment_leaves_everything_as_it_was(profile: str, order: Order) -> None:
    """The order comes at the n-th look for one, until the motion is over before it."""
    moment, outcome = 1, PlayOutcome.STOPPED
    while outcome is not PlayOutcome.DONE:
        stage = Stage(profile, InitialState(joints=(5.0, *HOME[1:]), motor_time=120 * MS))
        order_at(stage, moment, order)
        stage.channel.delay = 2 * MS
        ended = stage.play(plan(0x102, points=wave(20, 0.5), may_approach=True, log="anything"))
        machine, outcome = stage.simulator.machine, ended.outcome
        assert outcome in (PlayOutcome.DONE, PlayOutcome.STOPPED, PlayOutcome.HALTED), ended
        assert ended.left
        assert (machine.slave.mode, machine.owner, machine.open_objects) == (None, None, {}), moment
        assert not machine.motor_is_on(stage.channel.now())
        assert set(machine.tasks.values()) == {2}
        assert not machine.active_alarms
        logged = len(machine.log.records)
        stage.simulator.advance(stage.channel.now() + 100 * MS)
        assert len(machine.log.records) == logged
        assert machine.arm.is_at_rest(stage.channel.now() + 100 * MS)
        moment += 1 + moment // 10
    assert moment > 40


def test_an_order_ends_what_nobody_will_answer() -> None:
    stage = Stage()

    def look(_: int) -> Order | None:
        if "Motor" not in stage.calls:
            return None
        stage.channel.silent_from = 0
        return Order.STOP

    stage.pipe.at_poll = look
    stage.channel.delay = 20 * MS
    ended = stage.play(plan(0x202))
    assert (ended.outcome, ended.left) == (PlayOutcome.STOPPED, False)
    assert stage.channel.now() < 40_000 * MS


def test_robslave_is_stopped_if_an_order_comes_while_it_starts() -> None:
    stage = Stage("rc7")
    stage.pipe.at_poll = lambda _: Order.STOP if "Task_Start" in stage.calls else None
    assert stage.play(plan(0x002)).outcome is PlayOutcome.STOPPED
    assert "Task_Stop" in stage.calls
    assert set(stage.simulator.machine.tasks.values()) == {2}


def test_what_is_owed_is_told_before_it_is_begun() -> None:
    stage = Stage()
    stage.play(plan(0x202, log="anything"))
    owed = [message for message in stage.pipe.messages if isinstance(message, PendingCleanup)]
    debts = [CleanupTask.ARM, CleanupTask.MOTOR, CleanupTask.LOG, CleanupTask.SLAVE_MODE]
    growing = [tuple(debts[:count]) for count in range(5)]
    assert [each.debts for each in owed] == [*growing, *reversed(growing[:-1])]
    assert {each.port for each in owed} == {50000}
    assert owed[-1].generation == Generation.RC8


@pytest.mark.parametrize("profile", ["rc7", "rc8"])
def test_another_player_ends_what_one_has_left(profile: str) -> None:
    stage = Stage(profile)
    fall_silent(stage, 99)
    stage.play(plan(0x102))
    machine = stage.simulator.machine
    assert machine.slave.mode is not None
    owed = [message for message in stage.pipe.messages if isinstance(message, PendingCleanup)][-1]
    last = max(frame.serial for _, frame in stage.channel.sent)
    after = Stage(profile)
    after.channel = SimulatedChannel(stage.simulator, began=stage.channel.now())
    ended = after.play(plan(0x102, points=(), aftermath=owed, first_serial=last + 1000))
    assert (ended.outcome, ended.left) == (PlayOutcome.DONE, True)
    assert machine.slave.mode is None
    assert not machine.motor_is_on(after.channel.now())
    assert (machine.owner, machine.open_objects) == (None, {})
    assert set(machine.tasks.values()) == {2}
    assert not machine.active_alarms
    assert not [message for message in after.pipe.messages if isinstance(message, PlayerProblem)]


def test_a_motion_to_the_first_point_is_halted_by_another_player() -> None:
    stage = Stage(start=InitialState(joints=(60.0, *HOME[1:])))
    owed: list[PendingCleanup] = []

    def vanish(_: int) -> None:
        if "Robot_Move" in stage.calls and not owed:
            owed.extend(message for message in stage.pipe.messages if isinstance(message, PendingCleanup))
            stage.channel.silent_from = 0

    stage.pipe.at_poll = vanish
    stage.play(plan(0x202, may_approach=True, approach=0.1))
    assert owed[-1].debts == (CleanupTask.ARM, CleanupTask.MOTOR, CleanupTask.MOTION)
    arm, now = stage.simulator.machine.arm, stage.channel.now()
    assert not arm.is_at_rest(now)
    after = Stage()
    after.channel = SimulatedChannel(stage.simulator, began=now)
    ended = after.play(plan(0x202, points=(), aftermath=owed[-1], first_serial=9999))
    assert (ended.outcome, ended.left) == (PlayOutcome.DONE, True)
    assert after.calls[3:6] == ["Robot_Halt", "Motor", "GiveArm"]
    assert arm.is_at_rest(after.channel.now() + 100 * MS)


def test_what_the_controller_shows_after_a_player_was_killed_is_told() -> None:
    stage = Stage(start=InitialState(errors=(0x84201482,)))
    ended = stage.play(
        plan(
            0x202,
            points=(),
            aftermath=PendingCleanup((CleanupTask.SLAVE_MODE,), Generation.RC8, 1),
            first_serial=9,
        )
    )
    assert ended.outcome is PlayOutcome.DONE
    (trouble,) = [message for message in stage.pipe.messages if isinstance(message, PlayerProblem)]
    assert [code for code, _ in trouble.errors] == [0x84201482]
    assert "ClearError" not in stage.calls
