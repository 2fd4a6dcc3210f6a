"""A session with a controller: inspect, prepare, play, clean up.

However the session ends, the player undoes its steps in reverse order: slave mode, the log, motor, arm,
RobSlave, handles, Controller_Disconnect, Service_Stop. If the controller stops answering, the player skips
the remaining steps. After an order to stop, the player first brings the robot to rest on its path. After a
failure, the player can no longer steer the robot: a controller with an error has left slave mode, and a
silent controller accepts no set points. An order from the user ends any wait at once, unless the cleanup has
begun.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from math import isfinite

import numpy as np

from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.session import Session, halt_robot
from bcapscope.errors import BcapError, CallTimeout, ControllerError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Measured
from bcapscope.player.arm_limits import ArmLimits, limits_for_arm, with_limits
from bcapscope.player.blocking_caller import ABORT_CHECK_INTERVAL, BlockingCaller, Channel
from bcapscope.player.cleanup_stack import CleanupStack
from bcapscope.player.frame_recorder import FrameRecorder
from bcapscope.player.motion_checks import POSITION_TOLERANCE
from bcapscope.player.pacer import HaltedError, Pacer, SlvMoveCall
from bcapscope.player.player_messages import (
    TYPE_NAME_FACT,
    CleanupTask,
    ControllerInfo,
    Order,
    PendingCleanup,
    PlayEnded,
    PlayerProblem,
    PlayerQuestion,
    PlayOutcome,
    PlayPlan,
    PlayProgress,
    PlayState,
    QuestionTopic,
    SetPointValues,
    SlaveModePacing,
)
from bcapscope.player.player_pipe import PlayerPipe
from bcapscope.player.robot_adapter import RobotAdapter, pose_distance
from bcapscope.player.set_point_sequence import SetPointSequence
from bcapscope.player.smooth_curve import FIG_COLUMN, matches_posture
from bcapscope.player.trajectory import Trajectory, TrajectorySource
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import (
    PERIOD_NS,
    Generation,
    PoseType,
    SlaveMode,
    slave_mode_by_number,
)
from bcapscope.protocol.slave_mode.poses import pose_numbers
from bcapscope.protocol.tables.function_table import ObjectClass

PROGRESS_INTERVAL = 50_000_000
"""Time in ns from one progress report to the next."""

YES, NO, CLEAR, AGAIN = "yes", "no", "clear", "again"

_ROBOT_EXECUTE = 64
# The pacer keeps the lateness of this many set points: two hours at 8 ms.
_LATENESS_CAPACITY = 1_000_000


class PlayMonitor:
    pacer: Pacer

    def __init__(
        self, pipe: PlayerPipe, recorder: FrameRecorder, sequence: SetPointSequence, period: int
    ) -> None:
        self._pipe = pipe
        self._recorder = recorder
        self._sequence = sequence
        self._period = period
        self._next_report = 0

    def on_idle(self, now: int) -> None:
        """Obey orders from the pipe, and report progress. Raise HaltedError on an order to halt."""
        order = self._pipe.poll_order()
        if order is Order.HALT:
            raise HaltedError
        if order is Order.STOP:
            self._sequence.stop()
        if now >= self._next_report:
            self._next_report = now + PROGRESS_INTERVAL
            self._pipe.try_send(self.progress(now))

    def progress(self, now: int) -> PlayProgress:
        pacer, sequence = self.pacer, self._sequence
        left = max(0, sequence.total - sequence.index) * self._period / 1e9 if sequence.total else None
        return PlayProgress(
            PlayState.STOPPING if sequence.is_stopping else PlayState.PLAYING,
            sequence.index,
            sequence.total,
            0.0 if pacer.started_at is None else (now - pacer.started_at) / 1e9,
            None if sequence.is_stopping else left,
            pacer.lateness.estimated_spread(),
            pacer.counts,
            pacer.commanded,
            _pose_in(pacer.last_reply),
            self._recorder.last_sent,
            self._recorder.last_received,
            pacer.cycle.bins(),
        )


def _pose_in(reply: Frame | None) -> SetPointValues:
    """Return the pose in a reply; () if the reply has no pose, or if the pose holds NaN, which JSON lacks."""
    if reply is None or not reply.arguments:
        return ()
    row = pose_numbers(reply.arguments[0].variant) or ()
    return row if all(map(isfinite, row)) else ()


class PlayAbortedError(Exception):
    """Raised to end the session early; `reason` is None if the reason is unknown."""

    def __init__(self, outcome: PlayOutcome, reason: Message | None) -> None:
        super().__init__(outcome, reason)
        self.outcome = outcome
        self.reason = reason


class PlaySession:
    """A session with a controller; `has_log` is True if the controller's own log contains the motion."""

    def __init__(self, plan: PlayPlan, channel: Channel, pipe: PlayerPipe, recorder: FrameRecorder) -> None:
        self.has_log = False
        self._plan = plan
        self._channel = channel
        self._pipe = pipe
        self._recorder = recorder
        target = plan.target
        self._caller = BlockingCaller(
            channel, target.convention_for(channel.datagrams), recorder.on_frame, plan.first_serial
        )
        self._caller.check_abort = self._check_order
        self._session = Session(self._caller, target.retry_policies)
        names = {ObjectClass.ROBOT: plan.robot, ObjectClass.TASK: plan.task}
        self._robot = RobotAdapter(ObjectOpener(self._session, target, names), self._pause)
        self._cleanup = CleanupStack(self._robot, pipe, channel)
        self._pacer: Pacer | None = None
        self._retries_expected = False
        self._index = 0
        self._is_leaving = False
        self._was_off: dict[CleanupTask, bool] = {}

    async def run(self) -> PlayEnded:
        outcome, reason = PlayOutcome.DONE, None
        self._cleanup.push()
        try:
            if self._plan.aftermath is None:
                await self._connect_and_play()
            else:
                await self._clean_up_after_crash(self._plan.aftermath)
            outcome = PlayOutcome.LOOKED if self._plan.look_only else PlayOutcome.DONE
        except PlayAbortedError as end:
            outcome, reason = end.outcome, end.reason
        except ControllerError as error:
            outcome, reason = PlayOutcome.REFUSED, error.message
        except CallTimeout as error:
            outcome, reason = PlayOutcome.UNANSWERED, error.message
        except OSError as error:
            outcome, reason = PlayOutcome.UNANSWERED, os_reason(error)
            self._cleanup.is_controller_gone = True
        except BcapError as error:
            outcome, reason = PlayOutcome.FAILED, error.message
        finally:
            await self._close_session()
        return self._make_ended(outcome, reason)

    async def _connect_and_play(self) -> None:
        plan, robot = self._plan, self._robot
        self._session.check_armed = _refuse_unconfirmed_call
        self._report_state(PlayState.CONNECTING)
        await robot.identify()
        kind, mode = plan.kind, _slave_mode_for(plan, robot.generation)
        pose = await robot.read_pose(kind)
        trajectory = _planned_trajectory(plan, kind, pose)
        far = pose_distance(kind, pose, trajectory.set_point(0)) if trajectory else 0.0
        self._pipe.send(
            ControllerInfo(robot.is_simulator, robot.generation, robot.facts, mode.value, pose, far)
        )
        if plan.look_only or trajectory is None:
            return
        self._confirm_start()
        self._session.check_armed = None
        while True:
            try:
                return await self._play_once(mode, trajectory)
            except ControllerError as error:
                await self._offer_to_clear_errors(error)

    def _confirm_start(self) -> None:
        if not self._confirm(QuestionTopic.BEGIN, Message("play.question.begin")):
            raise PlayAbortedError(PlayOutcome.DECLINED, Message("play.not-confirmed"))
        robot = self._robot
        if robot.is_simulator or self._plan.armed:
            return
        named = ", ".join(f"{name} {value}" for name, value in robot.facts.items())
        text = Message("play.question.arm", robot=named) if named else Message("play.question.arm-unknown")
        if not self._confirm(QuestionTopic.ARM, text):
            raise PlayAbortedError(PlayOutcome.UNARMED, Message("play.not-armed"))

    async def _clean_up_after_crash(self, left: PendingCleanup) -> None:
        self._robot.generation = Generation(left.generation)
        self._is_leaving = True
        self._report_state(PlayState.LEAVING)
        await self._robot.connect()
        if CleanupTask.MOTION in left.debts:
            await self._halt()
        self._cleanup.push(*(task for task in left.debts if task is not CleanupTask.MOTION))
        await self._cleanup.clean_up_all()
        errors = () if self._cleanup.is_controller_gone else await self._robot.read_errors()
        if errors:
            self._pipe.send(PlayerProblem(Message("play.motion-not-ended"), errors))

    async def _play_once(self, mode: SlaveMode, trajectory: Trajectory) -> None:
        self._is_leaving = False
        try:
            await self._prepare(trajectory)
            self._report_state(PlayState.ENTERING)
            await self._robot.set_formats(trajectory.kind)
            # Push the cleanup task first, so that the cleanup leaves slave mode even if the call fails.
            self._cleanup.push(CleanupTask.SLAVE_MODE)
            await self._robot.robot.slv_change_mode(mode.value)
            await self._play(mode, trajectory)
        finally:
            self._is_leaving = True
            self._report_state(PlayState.LEAVING)
            await self._cleanup.clean_up_all()

    async def _prepare(self, trajectory: Trajectory) -> None:
        """Bring the robot to a state from which it can enter slave mode.

        If slave mode is already on, another client controls the robot, and the player gives up. Most calls of
        a second client end the first client's motion with an error (issue 42 of DENSORobot/denso_robot_ros).
        """
        robot, cleanup = self._robot, self._cleanup
        self._report_state(PlayState.PREPARING)
        mode = await robot.read_slave_mode()
        if mode:
            raise PlayAbortedError(PlayOutcome.DECLINED, Message("play.already-slave", mode=f"0x{mode:03X}"))
        await self._switch_on(CleanupTask.ROBSLAVE, await robot.is_robslave_ready(), robot.start_robslave)
        if robot.generation is not Generation.RC7:  # which has no TakeArm
            await cleanup.run_and_push(CleanupTask.ARM, robot.take_arm)
        await self._switch_on(CleanupTask.MOTOR, await robot.is_motor_on(), robot.motor_on)
        await self._approach(trajectory.kind, trajectory.set_point(0))
        if self._plan.log is not None:
            await cleanup.run_and_push(CleanupTask.LOG, robot.start_log)
            self.has_log = True

    async def _switch_on(self, task: CleanupTask, is_on: bool, step: Callable[[], Awaitable[None]]) -> None:
        """Switch on RobSlave or the motor. The cleanup switches off only what this session switched on."""
        was_off = self._was_off.setdefault(task, not is_on)
        if is_on:
            return
        await (self._cleanup.run_and_push(task, step) if was_off else step())

    async def _approach(self, kind: PoseType, first: SetPointValues) -> None:
        robot = self._robot
        here = await robot.read_pose(kind)
        far, has_posture = pose_distance(kind, here, first), matches_posture(kind, here, first)
        if far <= POSITION_TOLERANCE and has_posture:
            return
        if not self._plan.may_approach:
            distance, percent = Measured(far, digits=3), Measured(self._plan.approach)
            text = Message("play.question.approach", distance=distance, percent=percent)
            if not has_posture:
                fig, current = (Measured(each[FIG_COLUMN[kind]]) for each in (first, here))
                text = Message(
                    "play.question.approach-fig", distance=distance, percent=percent, fig=fig, current=current
                )
            if not self._confirm(QuestionTopic.APPROACH, text):
                raise PlayAbortedError(PlayOutcome.DECLINED, Message("play.not-at-start"))
        self._report_state(PlayState.APPROACHING)
        self._cleanup.push(CleanupTask.MOTION)
        try:
            await robot.approach(kind, first, self._plan.approach)
        except (PlayAbortedError, BcapError):
            await self._halt()  # the robot may be moving
            raise
        finally:
            self._cleanup.remove(CleanupTask.MOTION)

    async def _play(self, mode: SlaveMode, trajectory: Trajectory) -> None:
        """Send the set points. An order to stop brings the robot to rest; an order to halt halts the robot at
        once.
        """
        plan, robot = self._plan, self._robot
        hold = max(mode.buffer_slots + 1, -(-2 * PERIOD_NS // plan.period))
        sequence = SetPointSequence(trajectory, plan.period / 1e9, self._stop_limits(), plan.rounds, hold)
        handle = robot.robot.handle
        probe = (Variant(VT.I4, handle), Variant(VT.BSTR, "slvMove"))
        retry_policy = self._session.retry_policy_for(_ROBOT_EXECUTE, probe)
        move = SlvMoveCall(handle, robot.real_type, mode, retry_policy, plan.period)
        self._retries_expected = mode.paces_client and self._channel.datagrams
        capacity = min(
            _LATENESS_CAPACITY, sequence.total + 2 * hold if sequence.total else _LATENESS_CAPACITY
        )
        monitor = PlayMonitor(self._pipe, self._recorder, sequence, plan.period)
        pacer = self._pacer = monitor.pacer = Pacer(self._caller, move, sequence, monitor.on_idle, capacity)
        self._recorder.is_pacing = True
        try:
            pacer.play()
        except HaltedError:
            self._recorder.is_pacing = False
            self._caller.abandon()
            await self._halt()
            raise PlayAbortedError(PlayOutcome.HALTED, self._pipe.reason) from None
        finally:
            self._recorder.is_pacing = False
            self._caller.abandon()
            self._index = sequence.index
            self._pipe.send(monitor.progress(self._channel.now()))
        if sequence.is_stopping:
            raise PlayAbortedError(PlayOutcome.STOPPED, self._pipe.reason)

    async def _halt(self) -> None:
        """Halt the arm at once; the cleanup leaves slave mode afterwards."""
        self._is_leaving = True
        try:
            await halt_robot(self._session, self._robot.robot.handle, self._wait_async)
        except BcapError:
            pass  # the cleanup leaves slave mode even if the halt fails
        except OSError:
            self._cleanup.is_controller_gone = True

    async def _wait_async(self, length: int) -> None:
        self._channel.wait_until(self._channel.now() + length)

    async def _offer_to_clear_errors(self, error: ControllerError) -> None:
        """Report the controller's errors and offer to clear them. If the user wants to play
        again, return; otherwise, raise `error`.
        """
        latest = error
        while True:
            self._pipe.send(PlayerProblem(latest.message, await self._robot.read_errors()))
            text = Message("play.question.clear")
            answer = self._pipe.ask(PlayerQuestion(QuestionTopic.CLEAR, text, (NO, CLEAR, AGAIN)))
            if answer == NO:
                raise error
            self._report_state(PlayState.CLEARING)
            try:
                await self._robot.clear_errors()
                break
            except ControllerError as refusal:
                latest = refusal
        if answer == CLEAR:
            raise error

    async def _close_session(self) -> None:
        self._is_leaving = True
        if self._cleanup.is_controller_gone:
            self._channel.close()
        else:
            await self._session.close()

    def _confirm(self, topic: QuestionTopic, text: Message) -> bool:
        answer = self._pipe.ask(PlayerQuestion(topic, text, (NO, YES)))
        self._check_order()
        return answer == YES

    def _pause(self, length: int) -> None:
        """Wait for `length` ns. Raise PlayAbortedError if the player is ordered to stop or halt."""
        until = self._channel.now() + length
        while True:
            self._check_order()
            now = self._channel.now()
            if now >= until:
                return
            self._channel.wait_until(min(until, now + ABORT_CHECK_INTERVAL))

    def _check_order(self) -> None:
        """Raise PlayAbortedError after an order to stop or halt. During a halt or cleanup, ignore orders."""
        order = None if self._is_leaving else self._pipe.poll_order()
        if order is not None:
            outcome = PlayOutcome.HALTED if order is Order.HALT else PlayOutcome.STOPPED
            raise PlayAbortedError(outcome, self._pipe.reason)

    def _stop_limits(self) -> ArmLimits:
        """Return the arm's limits without the function `to_joints`, which is too slow during a motion."""
        base = limits_for_arm(self._robot.facts.get(TYPE_NAME_FACT, ""))
        return replace(with_limits(base, self._plan.limits), to_joints=None)

    def _report_state(self, state: PlayState) -> None:
        self._pipe.send(PlayProgress(state))

    def _make_ended(self, outcome: PlayOutcome, reason: Message | None) -> PlayEnded:
        pacer = self._pacer
        if pacer is None:
            return PlayEnded(outcome, reason, left=not self._cleanup.is_controller_gone)
        figures = pacer.lateness.exact_spread(), pacer.cycle.exact_spread(), pacer.counts
        return PlayEnded(
            outcome,
            reason,
            *figures,
            self._index,
            left=not self._cleanup.is_controller_gone,
            retries_expected=self._retries_expected,
        )


def _refuse_unconfirmed_call() -> None:
    raise PlayAbortedError(PlayOutcome.UNARMED, Message("play.not-confirmed-yet"))


def _slave_mode_for(plan: PlayPlan, generation: Generation) -> SlaveMode:
    """Return the slave mode to play in; raise PlayAbortedError if the mode does not fit the plan."""
    sync = 0x000 if generation is Generation.RC7 else 0x200
    family = 0x100 if plan.mode is SlaveModePacing.ASYNC else sync
    value = plan.mode if isinstance(plan.mode, int) else family | " PJT".index(plan.kind)
    mode = slave_mode_by_number(value, generation)
    if mode is None or mode.pose_type is None:
        raise PlayAbortedError(
            PlayOutcome.UNFIT, Message("play.no-such-mode", generation=str(generation), mode=f"{value:03X}")
        )
    if mode.pose_type is not plan.kind:
        reason = Message(
            "preflight.mode", mode=f"0x{value:03X}", accepted=str(mode.pose_type), kind=str(plan.kind)
        )
        raise PlayAbortedError(PlayOutcome.UNFIT, reason)
    return mode


def _planned_trajectory(plan: PlayPlan, kind: PoseType, pose: SetPointValues) -> Trajectory | None:
    """Return the plan's set points; None if there are none. Axes that the plan lacks come from `pose`."""
    if not plan.points:
        return None
    return Trajectory(kind, np.array(plan.points, dtype=np.float64), TrajectorySource("")).completed(pose)
