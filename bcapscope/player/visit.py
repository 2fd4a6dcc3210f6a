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

from bcapscope.client.halt import halt
from bcapscope.client.paces import PACES
from bcapscope.client.reach import Reach
from bcapscope.client.session import Session
from bcapscope.client.target import reason_of
from bcapscope.errors import BcapError, ControllerError, ExchangeTimeout
from bcapscope.player.channel import Channel
from bcapscope.player.checks_motion import NEAR
from bcapscope.player.course import Course
from bcapscope.player.curve import FIG, has_posture
from bcapscope.player.debts import Debts
from bcapscope.player.desk import Desk
from bcapscope.player.exchanger import LOOK_EACH, BlockingExchanger
from bcapscope.player.journal import Journal
from bcapscope.player.limits import Limits, limited, limits_of
from bcapscope.player.messages import (
    TYPE_NAME,
    Aftermath,
    Debt,
    Ended,
    Order,
    Outcome,
    Pacing,
    Peer,
    Plan,
    Point,
    Progress,
    Question,
    State,
    Topic,
    Trouble,
)
from bcapscope.player.monitor import Monitor
from bcapscope.player.pace import HaltedError, Move, Pacer
from bcapscope.player.station import Station, distance
from bcapscope.player.trajectory import Source, Trajectory
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.requester import Pace
from bcapscope.protocol.slavemode import Generation, PoseType, SlaveMode, slave_mode
from bcapscope.protocol.variant import VT, Variant

_ROBOT_EXECUTE = 64
_CONTROL_PERIOD = 8_000_000
_CAPACITY = 1_000_000  # set points whose lateness is kept: two hours at 8 ms

_MODES = {
    (Pacing.SYNC, Generation.RC7): 0x000,
    (Pacing.SYNC, Generation.RC8): 0x200,
    (Pacing.ASYNC, Generation.RC7): 0x100,
    (Pacing.ASYNC, Generation.RC8): 0x100,
}
_KINDS = {PoseType.P: 1, PoseType.J: 2, PoseType.T: 3}

_TAKEN = (
    "the robot is in slave mode 0x{:03X} already: another client moves it, or has not left it, "
    "which Robot_Execute slvChangeMode 0 does"
)

YES, NO, CLEAR, AGAIN = "yes", "no", "clear", "again"
"""Answers to questions."""


class EndedEarly(Exception):
    """Somebody wants the visit to end.

    Attributes:
        outcome: how it ended.
    """

    def __init__(self, outcome: Outcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


class Visit:
    """One visit.

    Attributes:
        logged: the controller's log holds this visit's motion.
    """

    def __init__(self, plan: Plan, channel: Channel, desk: Desk, journal: Journal) -> None:
        """Get ready; nothing is sent yet."""
        self.logged = False
        self._plan = plan
        self._channel = channel
        self._desk = desk
        self._journal = journal
        target = plan.target
        usual = Convention.SEED if channel.datagrams else Convention.TCP0
        serial = plan.aftermath.serial if plan.aftermath else 1
        self._exchanger = BlockingExchanger(channel, target.convention or usual, journal.hear, serial)
        self._exchanger.look = self._look
        others = Pace(round(target.timeout * 1_000_000), target.retries)
        self._session = Session(self._exchanger, PACES._replace(others=others))
        names = {ObjectClass.ROBOT: plan.robot, ObjectClass.TASK: plan.task}
        reach = Reach(self._session, target.service, target.connect, names)
        self._station = Station(reach, self._pause)
        self._debts = Debts(self._station, desk, channel)
        self._pacer: Pacer | None = None
        self._retries_expected = False
        self._index = 0
        self._leaving = False
        self._was_off: dict[Debt, bool] = {}

    async def perform(self) -> Ended:
        """Do all that the plan says; return how it ended."""
        outcome, reason = Outcome.DONE, ""
        self._debts.owe()
        try:
            if self._plan.aftermath is None:
                await self._visit()
            else:
                await self._tidy(self._plan.aftermath)
            outcome = Outcome.LOOKED if self._plan.look_only else Outcome.DONE
        except EndedEarly as end:
            outcome, reason = end.outcome, str(end)
        except ControllerError as error:
            outcome, reason = Outcome.REFUSED, str(error)
        except ExchangeTimeout as error:
            outcome, reason = Outcome.UNANSWERED, str(error)
        except OSError as error:
            outcome, reason, self._debts.gone = Outcome.UNANSWERED, reason_of(error), True
        except BcapError as error:
            outcome, reason = Outcome.FAILED, str(error)
        finally:
            await self._close()
        return self._ended(outcome, reason)

    async def _visit(self) -> None:
        plan, station = self._plan, self._station
        self._show(State.CONNECTING)
        await station.look()
        kind, mode = plan.kind, _mode(plan, station.generation)
        pose = await station.pose(kind)
        trajectory = _trajectory(plan, kind, pose)
        far = distance(kind, pose, trajectory.vector(0)) if trajectory else 0.0
        self._desk.deliver(Peer(station.simulator, station.generation, station.facts, mode.value, pose, far))
        if plan.look_only or trajectory is None:
            return
        self._arm()
        while True:
            try:
                return await self._once(mode, trajectory)
            except ControllerError as error:
                await self._clear(error)

    def _arm(self) -> None:
        """Make sure that somebody wants it, and knows if a robot will move."""
        if self._ask(Topic.BEGIN, "Begin?", (NO, YES)) != YES:
            raise EndedEarly(Outcome.DECLINED, "nobody said that it may begin")
        station = self._station
        if station.simulator or self._plan.armed:
            return
        named = ", ".join(f"{name} {value}" for name, value in station.facts.items())
        text = f"A robot will move: {named or 'a controller that tells nothing of itself'}."
        if self._ask(Topic.ARM, text, (NO, YES)) != YES:
            raise EndedEarly(
                Outcome.UNARMED, "this is not the simulator, and nobody said that a robot may move"
            )

    async def _tidy(self, left: Aftermath) -> None:
        """End what a player before this one has begun, and tell what the controller shows."""
        self._station.generation = Generation(left.generation)
        self._leaving = True
        self._show(State.LEAVING)
        await self._station.connect()
        if Debt.MOTION in left.debts:
            await self._halt()
        self._debts.owe(*(debt for debt in left.debts if debt is not Debt.MOTION))
        await self._debts.settle()
        errors = () if self._debts.gone else await self._station.errors()
        if errors:
            self._desk.deliver(Trouble("the motion was not ended in order", errors))

    async def _once(self, mode: SlaveMode, trajectory: Trajectory) -> None:
        """Get ready, play and leave."""
        self._leaving = False
        try:
            await self._prepare(trajectory)
            self._show(State.ENTERING)
            await self._station.set_formats(trajectory.kind)
            self._debts.owe(Debt.SLAVE_MODE)  # even if it is refused: to be on the safe side
            await self._station.robot.slv_change_mode(mode.value)
            await self._play(mode, trajectory)
        finally:
            self._leaving = True
            self._show(State.LEAVING)
            await self._debts.settle()

    async def _prepare(self, trajectory: Trajectory) -> None:
        """Bring the robot to where slave mode can begin.

        In slave mode already, it is somebody else's: most calls would be an error that ends their motion
        (issue 42 of DENSORobot/denso_robot_ros).
        """
        station, debts = self._station, self._debts
        self._show(State.PREPARING)
        mode = await station.slave_mode()
        if mode:
            raise EndedEarly(Outcome.DECLINED, _TAKEN.format(mode))
        await self._switch_on(Debt.ROBSLAVE, await station.has_robslave(), station.start_robslave)
        if station.has_arm_to_take:
            await debts.begin(Debt.ARM, station.take_arm)
        await self._switch_on(Debt.MOTOR, await station.is_motor_on(), station.motor_on)
        await self._approach(trajectory.kind, trajectory.vector(0))
        if self._plan.log is not None:
            await debts.begin(Debt.LOG, station.start_log)
            self.logged = True

    async def _switch_on(self, debt: Debt, is_on: bool, step: Callable[[], Awaitable[None]]) -> None:
        """Switch something on that is off; off again in the end only if it was off when we came."""
        was_off = self._was_off.setdefault(debt, not is_on)
        if is_on:
            return
        await (self._debts.begin(debt, step) if was_off else step())

    async def _approach(self, kind: PoseType, first: Point) -> None:
        """Bring the robot to the first point, unless it is there."""
        station = self._station
        here = await station.pose(kind)
        far, posed = distance(kind, here, first), has_posture(kind, here, first)
        if far <= NEAR and posed:
            return
        if not self._plan.may_approach:
            fig = "" if posed else f", with Fig {first[FIG[kind]]:g} instead of {here[FIG[kind]]:g}"
            text = (
                f"The first set point is {far:.3g} (degrees or mm) from where the robot stands{fig}. "
                f"Move there at {self._plan.approach:g}% of its speed?"
            )
            if self._ask(Topic.APPROACH, text, (NO, YES)) != YES:
                raise EndedEarly(Outcome.DECLINED, "the robot is not at the first set point")
        self._show(State.APPROACHING)
        self._debts.owe(Debt.MOTION)
        try:
            await station.approach(kind, first, self._plan.approach)
        except (EndedEarly, BcapError):
            await self._halt()  # it may be on its way
            raise
        finally:
            self._debts.paid(Debt.MOTION)

    async def _play(self, mode: SlaveMode, trajectory: Trajectory) -> None:
        """Send the set points; come to rest, or halt, when that is ordered."""
        plan, station = self._plan, self._station
        hold = max(mode.slots + 1, -(-2 * _CONTROL_PERIOD // plan.period))
        course = Course(trajectory, plan.period / 1e9, self._limits(), plan.rounds, hold)
        handle = station.robot.handle
        probe = (Variant(VT.I4, handle), Variant(VT.BSTR, "slvMove"))
        move = Move(handle, station.real, mode, self._session.pace(_ROBOT_EXECUTE, probe), plan.period)
        self._retries_expected = mode.paces and self._channel.datagrams
        capacity = min(_CAPACITY, course.of + 2 * hold) if course.of else _CAPACITY
        monitor = Monitor(self._desk, self._journal, course, plan.period)
        pacer = self._pacer = monitor.pacer = Pacer(self._exchanger, move, course, monitor.idle, capacity)
        self._journal.pacing = True
        try:
            pacer.play()
        except HaltedError:
            self._journal.pacing = False
            self._exchanger.abandon()
            await self._halt()
            raise EndedEarly(Outcome.HALTED, self._desk.reason) from None
        finally:
            self._journal.pacing = False
            self._exchanger.abandon()
            self._index = course.index
            self._desk.deliver(monitor.progress(self._channel.now()))
        if course.stopping:
            raise EndedEarly(Outcome.STOPPED, self._desk.reason)

    async def _halt(self) -> None:
        """Stop the arm at once; slave mode is left afterwards, on the way out."""
        self._leaving = True
        try:
            await halt(self._session, self._station.robot.handle, self._let_pass)
        except BcapError:
            pass  # all that is left is to leave slave mode, which comes next
        except OSError:
            self._debts.gone = True

    async def _let_pass(self, length: int) -> None:
        self._channel.wait(self._channel.now() + length)

    async def _clear(self, error: ControllerError) -> None:
        """Read what the controller shows, then offer to clear it; return if it is to be played again.

        An order instead of an answer is a no, and the error remains what ended the visit.

        Raises:
            ControllerError: it is not.
        """
        told = error
        while True:
            self._desk.deliver(Trouble(str(told), await self._station.errors()))
            text = "Clear the error, or clear it and begin again: RobSlave, first set point, slave mode?"
            answer = self._desk.ask(Question(Topic.CLEAR, text, (NO, CLEAR, AGAIN)))
            if answer == NO:
                raise error
            self._show(State.CLEARING)
            try:
                await self._station.clear_errors()
                break
            except ControllerError as refusal:
                told = refusal
        if answer == CLEAR:
            raise error

    async def _close(self) -> None:
        """Let go of the handles and the service; without waiting where nobody answers."""
        self._leaving = True
        if self._debts.gone:
            self._channel.close()
        else:
            await self._session.close()

    def _ask(self, topic: Topic, text: str, choices: tuple[str, ...]) -> str:
        """Ask the user.

        Raises:
            EndedEarly: there is an order instead of an answer.
        """
        answer = self._desk.ask(Question(topic, text, choices))
        self._obey()
        return answer

    def _pause(self, length: int) -> None:
        """Wait so many ns.

        Raises:
            EndedEarly: there is an order.
        """
        until = self._channel.now() + length
        while True:
            self._obey()
            now = self._channel.now()
            if now >= until:
                return
            self._channel.wait(min(until, now + LOOK_EACH))

    def _look(self) -> None:
        """Do as `_obey` while there is anything that an order could end."""
        if not self._leaving:
            self._obey()

    def _obey(self) -> None:
        order = self._desk.poll()
        if order is not None:
            outcome = Outcome.HALTED if order is Order.HALT else Outcome.STOPPED
            raise EndedEarly(outcome, self._desk.reason)

    def _limits(self) -> Limits:
        """Return what a stop keeps within; not by way of joints, which takes longer than there is time."""
        base = limits_of(self._station.facts.get(TYPE_NAME, ""))
        return replace(limited(base, self._plan.limits), to_joints=None)

    def _show(self, state: State) -> None:
        self._desk.deliver(Progress(state))

    def _ended(self, outcome: Outcome, reason: str) -> Ended:
        pacer = self._pacer
        if pacer is None:
            return Ended(outcome, reason, left=not self._debts.gone)
        figures = pacer.lateness.exact(), pacer.cycle.exact(), pacer.counts
        return Ended(
            outcome,
            reason,
            *figures,
            self._index,
            left=not self._debts.gone,
            retries_expected=self._retries_expected,
        )


def _mode(plan: Plan, generation: Generation) -> SlaveMode:
    """Return the slave mode to play in.

    Raises:
        EndedEarly: there is none.
    """
    value = plan.mode if isinstance(plan.mode, int) else _MODES[plan.mode, generation] | _KINDS[plan.kind]
    mode = slave_mode(value, generation)
    if mode is None or mode.pose_type is None:
        raise EndedEarly(Outcome.UNFIT, f"{generation} has no slave mode 0x{value:03X}")
    if mode.pose_type is not plan.kind:
        reason = (
            f"slave mode 0x{value:03X} takes {mode.pose_type} type, the set points are of {plan.kind} type"
        )
        raise EndedEarly(Outcome.UNFIT, reason)
    return mode


def _trajectory(plan: Plan, kind: PoseType, pose: Point) -> Trajectory | None:
    """Return the set points with all numbers that slvMove takes; None if there are none."""
    if not plan.points:
        return None
    return Trajectory(kind, np.array(plan.points, dtype=np.float64), Source("", "")).completed(pose)
