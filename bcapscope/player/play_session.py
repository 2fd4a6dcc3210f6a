"""A visit to a controller: look, get ready, play, leave in order.

However a visit ends, what was begun is ended in reverse order: slave mode, the log, motor, arm, RobSlave,
handles, Controller_Disconnect, Service_Stop. Only where the controller no longer answers is the rest left to
it. An order to stop lets the robot come to rest on its way first; nothing else can, since after an error the
controller has left slave mode, and one that does not answer takes no set points. An order ends whatever is
waited for, until everything is being ended.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace

import numpy as np

from bcapscope.client.controller_target import os_error_text
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.retry_policies import DEFAULT_RETRY_POLICIES
from bcapscope.client.robot_halt import halt_robot
from bcapscope.client.session import Session
from bcapscope.errors import BcapError, CallTimeout, ControllerError
from bcapscope.player.arm_limits import ArmLimits, limits_for_arm, with_limits
from bcapscope.player.blocking_caller import ABORT_CHECK_INTERVAL, BlockingCaller
from bcapscope.player.channel import Channel
from bcapscope.player.cleanup_stack import CleanupStack
from bcapscope.player.frame_recorder import FrameRecorder
from bcapscope.player.monitor import PlayMonitor
from bcapscope.player.motion_checks import POSITION_TOLERANCE
from bcapscope.player.pacer import HaltedError, Pacer, SlvMoveCall
from bcapscope.player.player_messages import (
    TYPE_NAME_FACT,
    Aftermath,
    CleanupTask,
    ControllerInfo,
    Order,
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
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, SlaveMode, slave_mode_by_number
from bcapscope.protocol.tables.function_table import ObjectClass

_ROBOT_EXECUTE = 64
_CONTROL_PERIOD = 8_000_000
_LATENESS_CAPACITY = 1_000_000  # set points whose lateness is kept: two hours at 8 ms

_MODES = {
    (SlaveModePacing.SYNC, Generation.RC7): 0x000,
    (SlaveModePacing.SYNC, Generation.RC8): 0x200,
    (SlaveModePacing.ASYNC, Generation.RC7): 0x100,
    (SlaveModePacing.ASYNC, Generation.RC8): 0x100,
}
_KINDS = {PoseType.P: 1, PoseType.J: 2, PoseType.T: 3}

_ALREADY_IN_SLAVE_MODE = (
    "the robot is in slave mode 0x{:03X} already: another client moves it, or has not left it, "
    "which Robot_Execute slvChangeMode 0 does"
)

YES, NO, CLEAR, AGAIN = "yes", "no", "clear", "again"
"""Answers to questions."""


class PlayAbortedError(Exception):
    """Somebody wants the visit to end.

    Attributes:
        outcome: how it ended.
    """

    def __init__(self, outcome: PlayOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


class PlaySession:
    """One visit.

    Attributes:
        has_log: the controller's log holds this visit's motion.
    """

    def __init__(self, plan: PlayPlan, channel: Channel, pipe: PlayerPipe, recorder: FrameRecorder) -> None:
        """Get ready; nothing is sent yet."""
        self.has_log = False
        self._plan = plan
        self._channel = channel
        self._pipe = pipe
        self._recorder = recorder
        target = plan.target
        usual = ReservedConvention.SEED if channel.datagrams else ReservedConvention.TCP0
        serial = plan.aftermath.serial if plan.aftermath else 1
        self._caller = BlockingCaller(channel, target.convention or usual, recorder.on_frame, serial)
        self._caller.check_abort = self._check_order_if_playing
        others = RetryPolicy(round(target.timeout * 1_000_000), target.retries)
        self._session = Session(self._caller, DEFAULT_RETRY_POLICIES._replace(others=others))
        names = {ObjectClass.ROBOT: plan.robot, ObjectClass.TASK: plan.task}
        reach = ObjectOpener(self._session, target.service, target.connect, names)
        self._robot = RobotAdapter(reach, self._pause)
        self._cleanup = CleanupStack(self._robot, pipe, channel)
        self._pacer: Pacer | None = None
        self._retries_expected = False
        self._index = 0
        self._is_leaving = False
        self._was_off: dict[CleanupTask, bool] = {}

    async def run(self) -> PlayEnded:
        """Do all that the plan says; return how it ended."""
        outcome, reason = PlayOutcome.DONE, ""
        self._cleanup.push()
        try:
            if self._plan.aftermath is None:
                await self._connect_and_play()
            else:
                await self._clean_up_after_crash(self._plan.aftermath)
            outcome = PlayOutcome.LOOKED if self._plan.look_only else PlayOutcome.DONE
        except PlayAbortedError as end:
            outcome, reason = end.outcome, str(end)
        except ControllerError as error:
            outcome, reason = PlayOutcome.REFUSED, str(error)
        except CallTimeout as error:
            outcome, reason = PlayOutcome.UNANSWERED, str(error)
        except OSError as error:
            outcome, reason, self._cleanup.is_controller_gone = (
                PlayOutcome.UNANSWERED,
                os_error_text(error),
                True,
            )
        except BcapError as error:
            outcome, reason = PlayOutcome.FAILED, str(error)
        finally:
            await self._close_session()
        return self._make_ended(outcome, reason)

    async def _connect_and_play(self) -> None:
        plan, station = self._plan, self._robot
        self._report_state(PlayState.CONNECTING)
        await station.identify()
        kind, mode = plan.kind, _slave_mode_for(plan, station.generation)
        pose = await station.read_pose(kind)
        trajectory = _planned_trajectory(plan, kind, pose)
        far = pose_distance(kind, pose, trajectory.set_point(0)) if trajectory else 0.0
        self._pipe.send(
            ControllerInfo(station.is_simulator, station.generation, station.facts, mode.value, pose, far)
        )
        if plan.look_only or trajectory is None:
            return
        self._confirm_start()
        while True:
            try:
                return await self._play_once(mode, trajectory)
            except ControllerError as error:
                await self._offer_to_clear_errors(error)

    def _confirm_start(self) -> None:
        """Make sure that somebody wants it, and knows if a robot will move."""
        if self._ask(QuestionTopic.BEGIN, "Begin?", (NO, YES)) != YES:
            raise PlayAbortedError(PlayOutcome.DECLINED, "nobody said that it may begin")
        station = self._robot
        if station.is_simulator or self._plan.armed:
            return
        named = ", ".join(f"{name} {value}" for name, value in station.facts.items())
        text = f"A robot will move: {named or 'a controller that tells nothing of itself'}."
        if self._ask(QuestionTopic.ARM, text, (NO, YES)) != YES:
            raise PlayAbortedError(
                PlayOutcome.UNARMED, "this is not the simulator, and nobody said that a robot may move"
            )

    async def _clean_up_after_crash(self, left: Aftermath) -> None:
        """End what a player before this one has begun, and tell what the controller shows."""
        self._robot.generation = Generation(left.generation)
        self._is_leaving = True
        self._report_state(PlayState.LEAVING)
        await self._robot.connect()
        if CleanupTask.MOTION in left.debts:
            await self._halt()
        self._cleanup.push(*(debt for debt in left.debts if debt is not CleanupTask.MOTION))
        await self._cleanup.clean_up_all()
        errors = () if self._cleanup.is_controller_gone else await self._robot.read_errors()
        if errors:
            self._pipe.send(PlayerProblem("the motion was not ended in order", errors))

    async def _play_once(self, mode: SlaveMode, trajectory: Trajectory) -> None:
        """Get ready, play and leave."""
        self._is_leaving = False
        try:
            await self._prepare(trajectory)
            self._report_state(PlayState.ENTERING)
            await self._robot.set_formats(trajectory.kind)
            self._cleanup.push(CleanupTask.SLAVE_MODE)  # even if it is refused: to be on the safe side
            await self._robot.robot.slv_change_mode(mode.value)
            await self._play(mode, trajectory)
        finally:
            self._is_leaving = True
            self._report_state(PlayState.LEAVING)
            await self._cleanup.clean_up_all()

    async def _prepare(self, trajectory: Trajectory) -> None:
        """Bring the robot to where slave mode can begin.

        In slave mode already, it is somebody else's: most calls would be an error that ends their motion
        (issue 42 of DENSORobot/denso_robot_ros).
        """
        station, debts = self._robot, self._cleanup
        self._report_state(PlayState.PREPARING)
        mode = await station.read_slave_mode()
        if mode:
            raise PlayAbortedError(PlayOutcome.DECLINED, _ALREADY_IN_SLAVE_MODE.format(mode))
        await self._switch_on(CleanupTask.ROBSLAVE, await station.is_robslave_ready(), station.start_robslave)
        if station.needs_take_arm:
            await debts.run_and_push(CleanupTask.ARM, station.take_arm)
        await self._switch_on(CleanupTask.MOTOR, await station.is_motor_on(), station.motor_on)
        await self._approach(trajectory.kind, trajectory.set_point(0))
        if self._plan.log is not None:
            await debts.run_and_push(CleanupTask.LOG, station.start_log)
            self.has_log = True

    async def _switch_on(self, debt: CleanupTask, is_on: bool, step: Callable[[], Awaitable[None]]) -> None:
        """Switch something on that is off; off again in the end only if it was off when we came."""
        was_off = self._was_off.setdefault(debt, not is_on)
        if is_on:
            return
        await (self._cleanup.run_and_push(debt, step) if was_off else step())

    async def _approach(self, kind: PoseType, first: SetPointValues) -> None:
        """Bring the robot to the first point, unless it is there."""
        station = self._robot
        here = await station.read_pose(kind)
        far, posed = pose_distance(kind, here, first), matches_posture(kind, here, first)
        if far <= POSITION_TOLERANCE and posed:
            return
        if not self._plan.may_approach:
            fig = (
                ""
                if posed
                else f", with Fig {first[FIG_COLUMN[kind]]:g} instead of {here[FIG_COLUMN[kind]]:g}"
            )
            text = (
                f"The first set point is {far:.3g} (degrees or mm) from where the robot stands{fig}. "
                f"Move there at {self._plan.approach:g}% of its speed?"
            )
            if self._ask(QuestionTopic.APPROACH, text, (NO, YES)) != YES:
                raise PlayAbortedError(PlayOutcome.DECLINED, "the robot is not at the first set point")
        self._report_state(PlayState.APPROACHING)
        self._cleanup.push(CleanupTask.MOTION)
        try:
            await station.approach(kind, first, self._plan.approach)
        except (PlayAbortedError, BcapError):
            await self._halt()  # it may be on its way
            raise
        finally:
            self._cleanup.remove(CleanupTask.MOTION)

    async def _play(self, mode: SlaveMode, trajectory: Trajectory) -> None:
        """Send the set points; come to rest, or halt, when that is ordered."""
        plan, station = self._plan, self._robot
        hold = max(mode.buffer_slots + 1, -(-2 * _CONTROL_PERIOD // plan.period))
        course = SetPointSequence(trajectory, plan.period / 1e9, self._stop_limits(), plan.rounds, hold)
        handle = station.robot.handle
        probe = (Variant(VT.I4, handle), Variant(VT.BSTR, "slvMove"))
        move = SlvMoveCall(
            handle,
            station.real_type,
            mode,
            self._session.retry_policy_for(_ROBOT_EXECUTE, probe),
            plan.period,
        )
        self._retries_expected = mode.paces_client and self._channel.datagrams
        capacity = min(_LATENESS_CAPACITY, course.total + 2 * hold) if course.total else _LATENESS_CAPACITY
        monitor = PlayMonitor(self._pipe, self._recorder, course, plan.period)
        pacer = self._pacer = monitor.pacer = Pacer(self._caller, move, course, monitor.on_idle, capacity)
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
            self._index = course.index
            self._pipe.send(monitor.progress(self._channel.now()))
        if course.is_stopping:
            raise PlayAbortedError(PlayOutcome.STOPPED, self._pipe.reason)

    async def _halt(self) -> None:
        """Stop the arm at once; slave mode is left afterwards, on the way out."""
        self._is_leaving = True
        try:
            await halt_robot(self._session, self._robot.robot.handle, self._wait_async)
        except BcapError:
            pass  # all that is left is to leave slave mode, which comes next
        except OSError:
            self._cleanup.is_controller_gone = True

    async def _wait_async(self, length: int) -> None:
        self._channel.wait_until(self._channel.now() + length)

    async def _offer_to_clear_errors(self, error: ControllerError) -> None:
        """Read what the controller shows, then offer to clear it; return if it is to be played again.

        An order instead of an answer is a no, and the error remains what ended the visit.

        Raises:
            ControllerError: it is not.
        """
        told = error
        while True:
            self._pipe.send(PlayerProblem(str(told), await self._robot.read_errors()))
            text = "Clear the error, or clear it and begin again: RobSlave, first set point, slave mode?"
            answer = self._pipe.ask(PlayerQuestion(QuestionTopic.CLEAR, text, (NO, CLEAR, AGAIN)))
            if answer == NO:
                raise error
            self._report_state(PlayState.CLEARING)
            try:
                await self._robot.clear_errors()
                break
            except ControllerError as refusal:
                told = refusal
        if answer == CLEAR:
            raise error

    async def _close_session(self) -> None:
        """Let go of the handles and the service; without waiting where nobody answers."""
        self._is_leaving = True
        if self._cleanup.is_controller_gone:
            self._channel.close()
        else:
            await self._session.close()

    def _ask(self, topic: QuestionTopic, text: str, choices: tuple[str, ...]) -> str:
        """Ask the user.

        Raises:
            PlayAbortedError: there is an order instead of an answer.
        """
        answer = self._pipe.ask(PlayerQuestion(topic, text, choices))
        self._check_order()
        return answer

    def _pause(self, length: int) -> None:
        """Wait so many ns.

        Raises:
            PlayAbortedError: there is an order.
        """
        until = self._channel.now() + length
        while True:
            self._check_order()
            now = self._channel.now()
            if now >= until:
                return
            self._channel.wait_until(min(until, now + ABORT_CHECK_INTERVAL))

    def _check_order_if_playing(self) -> None:
        """Do as `_check_order` while there is anything that an order could end."""
        if not self._is_leaving:
            self._check_order()

    def _check_order(self) -> None:
        order = self._pipe.poll_order()
        if order is not None:
            outcome = PlayOutcome.HALTED if order is Order.HALT else PlayOutcome.STOPPED
            raise PlayAbortedError(outcome, self._pipe.reason)

    def _stop_limits(self) -> ArmLimits:
        """Return what a stop keeps within; not by way of joints, which takes longer than there is time."""
        base = limits_for_arm(self._robot.facts.get(TYPE_NAME_FACT, ""))
        return replace(with_limits(base, self._plan.limits), to_joints=None)

    def _report_state(self, state: PlayState) -> None:
        self._pipe.send(PlayProgress(state))

    def _make_ended(self, outcome: PlayOutcome, reason: str) -> PlayEnded:
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


def _slave_mode_for(plan: PlayPlan, generation: Generation) -> SlaveMode:
    """Return the slave mode to play in.

    Raises:
        PlayAbortedError: there is none.
    """
    value = plan.mode if isinstance(plan.mode, int) else _MODES[plan.mode, generation] | _KINDS[plan.kind]
    mode = slave_mode_by_number(value, generation)
    if mode is None or mode.pose_type is None:
        raise PlayAbortedError(PlayOutcome.UNFIT, f"{generation} has no slave mode 0x{value:03X}")
    if mode.pose_type is not plan.kind:
        reason = (
            f"slave mode 0x{value:03X} takes {mode.pose_type} type, the set points are of {plan.kind} type"
        )
        raise PlayAbortedError(PlayOutcome.UNFIT, reason)
    return mode


def _planned_trajectory(plan: PlayPlan, kind: PoseType, pose: SetPointValues) -> Trajectory | None:
    """Return the set points with all numbers that slvMove takes; None if there are none."""
    if not plan.points:
        return None
    return Trajectory(kind, np.array(plan.points, dtype=np.float64), TrajectorySource("", "")).completed(pose)
