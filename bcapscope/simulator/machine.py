"""The controller that all clients share: modes, motor, arm, tasks, errors, and how time changes them.

All times are in ns of the caller's clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NoReturn

from bcapscope.protocol.slave_mode.modes import PERIOD_NS
from bcapscope.protocol.tables.hresult import E_ARM_NOT_TAKEN, E_FAIL, E_NOT_IN_SLAVE_MODE, describe_hresult
from bcapscope.simulator.arm import MS, Arm, TimedMove
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError
from bcapscope.simulator.equipment import Equipment
from bcapscope.simulator.kinematics import AXIS_LIMITS, HOME, AxisLimit, Joints, axis_beyond_limit
from bcapscope.simulator.object_table import ObjectTable
from bcapscope.simulator.profile import Profile
from bcapscope.simulator.slave_drive import SlaveDrive
from bcapscope.simulator.variable_memory import VariableMemory

MOTOR_ON_TIME = 400 * MS
MANUAL, TEACH_CHECK, AUTOMATIC = 1, 2, 3
READY, RUNNING = 2, 3
"""States of a task, from GetStatus in ShoheiKobata/orin_bcap_python_samples."""

ROBSLAVE = "RobSlave"
ROBOT_TYPE = "BCAPSCOPE-SIM6"

MAX_RECORDS = 10_000
MAX_ACTIVE = 32
MAX_LOGGED = 128

OTHER_CLIENT = 0
"""Value of `Machine.owner` while the pendant or a client outside this network has the arm."""


@dataclass(frozen=True, slots=True)
class InitialState:
    """State of the controller when it is switched on.

    Attributes:
        joints: Eight joints in degrees.
        token: Whether Ethernet has the executable token.
        motor_time: Time in ns that the motor takes to switch on.
        speed: External speed in percent, as set on the pendant.
        tasks: Names of the loaded programs; `running` names those that run.
        errors: Codes of the active errors, oldest first.
        empty: Names in capitals of the robot variables whose value is EMPTY.
        arm_taken: Whether a client outside this network has the arm.
        object_width: Width in mm of an object between the fingers of the hands; None for no object.
        udp_clients: Number of half-open UDP clients; `tcp_clients` is the same for TCP.
        epoch: Time in ns since 1970 at which the model's clock is 0.
    """

    joints: Joints = HOME
    limits: tuple[AxisLimit, ...] = AXIS_LIMITS
    mode: int = AUTOMATIC
    token: bool = True
    motor: bool = False
    motor_time: int = MOTOR_ON_TIME
    speed: float = 100.0
    type_name: str = ROBOT_TYPE
    tasks: tuple[str, ...] = (ROBSLAVE, "Pro1")
    running: tuple[str, ...] = ()
    errors: tuple[int, ...] = ()
    empty: tuple[str, ...] = ()
    emergency: bool = False
    arm_taken: bool = False
    object_width: float | None = None
    udp_clients: int = 0
    tcp_clients: int = 0
    epoch: int = 0


@dataclass(slots=True)
class Speeds:
    """Speeds and accelerations in percent; the external values scale the internal values."""

    external: float = 100.0
    external_acceleration: float = 100.0
    external_deceleration: float = 100.0
    internal: float = 100.0
    acceleration: float = 100.0
    deceleration: float = 100.0

    def set_percent(self, refusal: int, **values: float) -> None:
        """Set values in percent. Refuse the call with `refusal` if a value is 0, negative or above 100."""
        if not all(0 < value <= 100 for value in values.values()):
            raise RefusedError(refusal)
        for name, value in values.items():
            setattr(self, name, value)

    def effective_share(self, speed: float | None) -> float:
        """Return a motion's speed as a share of the highest speed, from 0.001 to 1. `speed` is the internal
        speed in percent; None means the robot's internal speed.
        """
        internal = self.internal if speed is None else speed
        return max(0.001, min(1.0, self.external * internal / 10_000))


@dataclass(frozen=True, slots=True)
class Alarm:
    """One error: its HRESULT as an unsigned number, and its time in ns."""

    code: int
    time: int

    @property
    def text(self) -> str:
        return describe_hresult(self.code).text


class ControlLog:
    """Every 8 ms, records the time in ns since the start, the commanded joints and the measured joints."""

    def __init__(self, arm: Arm, started_at: int) -> None:
        self.records: deque[tuple[int, Joints, Joints]] = deque(maxlen=MAX_RECORDS)
        self.due: int | None = None
        self._arm = arm
        self._started_at = started_at

    def start(self, now: int) -> None:
        self.due = now if self.due is None else self.due

    def stop(self) -> None:
        self.due = None

    def advance(self, now: int) -> None:
        """Store the records that are due; after a long pause, only as many records as the log holds."""
        due = self.due
        if due is None:
            return
        if now - due > MAX_RECORDS * PERIOD_NS:
            due += (now - due) // PERIOD_NS * PERIOD_NS - MAX_RECORDS * PERIOD_NS
        while due <= now:
            self.records.append((due - self._started_at, self._arm.commanded(due), self._arm.actual(due)))
            due += PERIOD_NS
        self.due = due


class Machine:
    """The state of one controller.

    Attributes:
        active_alarms: Errors that ClearError has not cleared, newest first; `alarm_log` holds all errors.
        owner: Number of the client that has the arm; None if no client has it.
        open_objects: Objects that each client has opened, by client number.
        stop_count: How many times Robot_Halt, an error or the emergency stop has stopped motion.
        stopped_by: Result code that the latest stop gave to the calls that waited for the stopped motion.
        current_move: The latest ordinary motion; None before the first motion and after a stop.
    """

    def __init__(self, profile: Profile, initial_state: InitialState | None = None, now: int = 0) -> None:
        self.profile = profile
        self.initial_state = initial_state or InitialState()
        self.started_at = now
        self.arm = Arm(self.initial_state.joints)
        self.slave = SlaveDrive(self.arm, self.initial_state.limits)
        self.active_alarms: deque[Alarm] = deque(maxlen=MAX_ACTIVE)
        self.alarm_log: deque[Alarm] = deque(maxlen=MAX_LOGGED)
        self.log = ControlLog(self.arm, now)
        self.memory = VariableMemory(profile.real)
        self.speeds = Speeds(external=self.initial_state.speed)
        self.mode = self.initial_state.mode
        self.auto_mode = 2
        self.emergency = self.initial_state.emergency
        self.owner: int | None = OTHER_CLIENT if self.initial_state.arm_taken else None
        self.tasks = dict.fromkeys((name.casefold() for name in self.initial_state.tasks), READY)
        self.tasks |= dict.fromkeys((name.casefold() for name in self.initial_state.running), RUNNING)
        self.files = {f"{name}.pac".casefold(): f"{name}.pac" for name in self.initial_state.tasks}
        self.open_objects: dict[int, ObjectTable] = {}
        self.tool = 0
        self.work = 0
        self.stop_count = 0
        self.stopped_by = 0
        self.current_move: TimedMove | None = None
        self.equipment = Equipment(self.initial_state.object_width)
        self._motor_at: int | None = now if self.initial_state.motor else None
        for code in (*self.initial_state.errors, *((RefusalCode.EMERGENCY_STOP,) if self.emergency else ())):
            self._add_alarm(code, now)

    def date(self, now: int) -> float:
        """Return the controller's date and time as days since 1899-12-30."""
        return (self.initial_state.epoch + now) / 86_400e9 + 25569.0

    @property
    def free_at(self) -> int:
        """Time in ns from which another motion may begin."""
        return self.current_move.done_at if self.current_move else self.started_at

    @property
    def is_held(self) -> bool:
        return self.current_move is not None and self.current_move.is_held

    def motor_is_on(self, now: int) -> bool:
        return self._motor_at is not None and now >= self._motor_at

    def switch_motor(self, on: bool, now: int) -> int:
        """Return the time in ns when the switching ends. `check_state` may refuse to switch the motor on."""
        if not on:
            self._lose_power()
            self.stop(now, RefusalCode.MOTOR_IS_OFF, is_reported=False)
            return now
        self.check_state()
        if self._motor_at is None:
            self._motor_at = now + self.initial_state.motor_time
        return self._motor_at

    def check_state(self) -> None:
        """Refuse a call if an emergency stop, an active error, the mode or the missing token forbids it."""
        if self.emergency:
            raise RefusedError(RefusalCode.EMERGENCY_STOP)
        if self.active_alarms:
            raise RefusedError(RefusalCode.ERROR_IS_ACTIVE)
        if self.mode != AUTOMATIC:
            raise RefusedError(RefusalCode.NOT_AUTOMATIC)
        if not self.initial_state.token:
            raise RefusedError(RefusalCode.NO_TOKEN)

    def check_motor(self, now: int) -> None:
        self.check_state()
        if not self.motor_is_on(now):
            raise RefusedError(RefusalCode.MOTOR_IS_OFF)

    def check_motion(self, client: int, now: int) -> None:
        self.check_motor(now)
        self.check_arm(client)

    def check_arm(self, client: int) -> None:
        if self.profile.needs_arm and self.owner != client:
            raise RefusedError(E_ARM_NOT_TAKEN)

    def check_slave_mode(self, client: int, now: int) -> None:
        self.check_motion(client, now)
        if self.profile.needs_robslave and self.tasks.get(ROBSLAVE.casefold()) != RUNNING:
            raise RefusedError(E_FAIL)

    def check_reach(self, joints: Joints) -> None:
        axis = axis_beyond_limit(joints, self.initial_state.limits)
        if axis:
            raise RefusedError(RefusalCode.SOFTWARE_LIMIT + axis)

    def stop(self, now: int, code: int, is_reported: bool = True) -> None:
        """End motions and slave mode. Calls that wait for a motion or for slave mode return `code`. Unless
        `is_reported`, the next slvMove also returns `code`.
        """
        self.slave.leave(0 if is_reported else code)
        self.arm.halt(now)
        self.equipment.stop(now)
        self.stop_count += 1
        self.stopped_by = code
        self.current_move = None

    def raise_error(self, code: int, now: int, is_reported: bool = False) -> None:
        """End all motions, slave mode and RobSlave. The error is active until ClearError.

        Three kinds of errors also switch the motor off: an error of level 4 or above, the emergency stop, and
        a set point beyond a limit. `is_reported` is as in `stop`.
        """
        self._add_alarm(code, now)
        self.stop(now, code, is_reported)
        if ROBSLAVE.casefold() in self.tasks:
            self.tasks[ROBSLAVE.casefold()] = READY
        level = code >> 24 & 0xF if code >> 28 == 8 else 0
        if level >= 4 or code & ~0xF == RefusalCode.POSITION_LIMIT or code == RefusalCode.EMERGENCY_STOP:
            self._lose_power()

    def refuse(self, code: int, now: int) -> NoReturn:
        """Refuse a call, and raise the error `code` unless this error is already active.

        If each refusal were listed, 32 refused set points would displace the error that ended slave mode.
        """
        if all(alarm.code != code for alarm in self.active_alarms):
            self.raise_error(code, now, is_reported=True)
        raise RefusedError(code)

    def clear_errors(self) -> None:
        self.active_alarms.clear()
        self.slave.unreported_result = 0

    def switch_mode(self, mode: int, now: int) -> None:
        self.mode = mode
        if mode != AUTOMATIC:
            self._lose_power()
            self.stop(now, RefusalCode.NOT_AUTOMATIC, is_reported=False)

    def start_task(self, name: str) -> None:
        self.check_state()
        self.tasks[name.casefold()] = RUNNING

    def stop_task(self, name: str, now: int) -> None:
        """On RC7, stopping RobSlave ends slave mode."""
        self.tasks[name.casefold()] = READY
        if name.casefold() == ROBSLAVE.casefold() and self.profile.needs_robslave and self.slave.mode:
            self.stop(now, E_NOT_IN_SLAVE_MODE)

    def press_emergency_stop(self, now: int) -> None:
        self.emergency = True
        self.raise_error(RefusalCode.EMERGENCY_STOP, now)

    def advance(self, now: int) -> None:
        slave, log = self.slave, self.log
        if slave.mode is not None and slave.next_tick <= now:
            code = slave.advance(now)
            if code is not None:
                self.raise_error(code, slave.next_tick)
        if log.due is not None:
            log.advance(now)
        collision = self.equipment.hand.collides_at
        if collision is not None and collision <= now:
            self.equipment.hand.stop(collision, RefusalCode.HAND_DEVIATION)
            self.raise_error(RefusalCode.HAND_DEVIATION, collision)

    def due(self) -> int | None:
        slave = self.slave
        due = None if slave.mode is None or slave.is_empty else slave.next_tick
        collision = self.equipment.hand.collides_at
        return due if collision is None else collision if due is None else min(due, collision)

    def _add_alarm(self, code: int, now: int) -> None:
        alarm = Alarm(code & 0xFFFFFFFF, now)
        self.active_alarms.appendleft(alarm)
        self.alarm_log.appendleft(alarm)

    def _lose_power(self) -> None:
        self._motor_at = None
        self.equipment.hand.lose_grip()
        self.equipment.vacuum = 0.0
