"""The controller that all clients share: modes, motor, arm, tasks, errors, and what time does to them.

Which condition is checked and refused with which code: the public list of controller errors in
nkawa/Denso_CobottaPro900_MQTT_Control and the issues of DENSORobot/denso_robot_ros. The order of the checks
and all durations are ours. Times are ns of a clock that is passed in.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

from bcapscope.protocol.tables.hresult import E_ARM_NOT_TAKEN, E_FAIL, E_NOT_IN_SLAVE_MODE
from bcapscope.simulator.alarms import Alarms
from bcapscope.simulator.arm import MS, Arm
from bcapscope.simulator.call_outcome import RefusedError
from bcapscope.simulator.control_log_ring import ControlLog, ControlLogRecord
from bcapscope.simulator.equipment import Equipment
from bcapscope.simulator.kinematics import AXIS_LIMITS, HOME, AxisLimit, Joints, axis_beyond_limit
from bcapscope.simulator.object_table import ObjectTable
from bcapscope.simulator.profile import Profile
from bcapscope.simulator.result_codes import (
    EMERGENCY_STOP,
    ERROR_IS_ACTIVE,
    HAND_DEVIATION,
    MOTOR_IS_OFF,
    NO_TOKEN,
    NOT_AUTOMATIC,
    POSITION_LIMIT,
    SOFTWARE_LIMIT,
    error_level,
)
from bcapscope.simulator.slave_drive import SlaveDrive
from bcapscope.simulator.timed_move import TimedMove
from bcapscope.simulator.variable_memory import VariableMemory

MOTOR_ON_TIME = 400 * MS
MANUAL, TEACH_CHECK, AUTOMATIC = 1, 2, 3
READY, RUNNING = 2, 3
"""States of a task: ShoheiKobata/orin_bcap_python_samples, GetStatus."""

ROBSLAVE = "RobSlave"
ROBOT_TYPE = "BCAPSCOPE-SIM6"

OTHER_CLIENT = 0
"""Owner of the arm who is none of the clients, which are numbered from 1: the pendant, or another network."""


@dataclass(frozen=True, slots=True)
class InitialState:
    """What the controller is like when it is switched on.

    Attributes:
        joints: eight, degrees.
        limits: of the six axes.
        mode: 1 manual, 2 teach check, 3 automatic.
        token: the executable token is Ethernet's.
        motor: on already.
        motor_time: ns that it takes to go on.
        speed: external speed in percent, as set on the pendant.
        type_name: of the robot.
        tasks: programs that are loaded.
        running: those of them that run.
        errors: active ones, the oldest first.
        empty: names of variables of the robot that answer EMPTY, in capitals.
        emergency: the emergency stop is pressed.
        arm_taken: a client that is not seen here has the arm.
        object_width: of an object between the fingers of the hands, mm; None for no object.
        udp_clients: places on UDP that half-open clients hold.
        tcp_clients: the same on TCP.
        epoch: ns since 1970 at the time 0 of the model's clock.
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
    """Percentages; the external ones scale the internal ones."""

    external: float = 100.0
    external_acceleration: float = 100.0
    external_deceleration: float = 100.0
    internal: float = 100.0
    acceleration: float = 100.0
    deceleration: float = 100.0

    def effective_share(self, speed: float | None) -> float:
        """Return the share of the highest speed that a motion has, above 0 up to 1.

        Args:
            speed: internal one in percent; None for the usual one.
        """
        internal = self.internal if speed is None else speed
        return max(0.001, min(1.0, self.external * internal / 10_000))


class Machine:
    """The state of one controller.

    Attributes:
        owner: number of the client that has the arm; None while nobody has it.
        open_objects: what each client has opened, by its number.
        stop_count: counts what has stopped motions: Robot_Halt, errors, the emergency stop.
        stopped_by: result of the last of them.
        current_move: the last ordinary motion; None if it was stopped.
        equipment: hands and what else belongs to the controller.
    """

    def __init__(self, profile: Profile, initial_state: InitialState | None = None, now: int = 0) -> None:
        self.profile = profile
        self.initial_state = initial_state or InitialState()
        self.started_at = now
        self.arm = Arm(self.initial_state.joints)
        self.slave = SlaveDrive(self.arm, self.initial_state.limits, profile.async_detector)
        self.alarms = Alarms()
        self.log = ControlLog()
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
        self.equipment = Equipment.with_object(self.initial_state.object_width)
        self._motor_at: int | None = now if self.initial_state.motor else None
        for code in (*self.initial_state.errors, *((EMERGENCY_STOP,) if self.emergency else ())):
            self.alarms.add(code, now)

    def date(self, now: int) -> float:
        """Return the controller's clock as days since 1899-12-30."""
        return (self.initial_state.epoch + now) / 86_400e9 + 25569.0

    @property
    def free_at(self) -> int:
        """Return from when on another motion may begin, ns."""
        return self.current_move.done_at if self.current_move else self.started_at

    @property
    def is_held(self) -> bool:
        """Whether a motion is paused."""
        return self.current_move is not None and self.current_move.is_held

    def motor_is_on(self, now: int) -> bool:
        """Tell whether the motor is on."""
        return self._motor_at is not None and now >= self._motor_at

    def switch_motor(self, on: bool, now: int) -> int:
        """Switch the motor; return when it is done."""
        if not on:
            self._lose_power()
            self.stop(now, MOTOR_IS_OFF, is_reported=False)
            return now
        self.check_state()
        if self._motor_at is None:
            self._motor_at = now + self.initial_state.motor_time
        return self._motor_at

    def check_state(self) -> None:
        """Refuse what needs a controller without trouble.

        Raises:
            RefusedError: emergency stop, an active error, not in automatic mode, or no executable token.
        """
        if self.emergency:
            raise RefusedError(EMERGENCY_STOP)
        if self.alarms.active:
            raise RefusedError(ERROR_IS_ACTIVE)
        if self.mode != AUTOMATIC:
            raise RefusedError(NOT_AUTOMATIC)
        if not self.initial_state.token:
            raise RefusedError(NO_TOKEN)

    def check_motion(self, client: int, now: int) -> None:
        """Refuse what moves the robot unless everything is ready for it.

        Raises:
            RefusedError: something is not, or the arm is not this client's.
        """
        self.check_state()
        if not self.motor_is_on(now):
            raise RefusedError(MOTOR_IS_OFF)
        if self.profile.needs_arm and self.owner != client:
            raise RefusedError(E_ARM_NOT_TAKEN)

    def check_slave_mode(self, client: int, now: int) -> None:
        """Refuse slave mode unless everything is ready for it.

        RC7 needs the program RobSlave (DENSO Wave 2009, How to use the Slave mode); what it answers without
        it is not documented.

        Raises:
            RefusedError: something is not.
        """
        self.check_motion(client, now)
        if self.profile.needs_robslave and self.tasks.get(ROBSLAVE.casefold()) != RUNNING:
            raise RefusedError(E_FAIL)

    def check_reach(self, joints: Joints) -> None:
        """Refuse joints beyond their limits.

        Raises:
            RefusedError: with the software limit of the first such axis.
        """
        axis = axis_beyond_limit(joints, self.initial_state.limits)
        if axis:
            raise RefusedError(SOFTWARE_LIMIT + axis)

    def stop(self, now: int, code: int, is_reported: bool = True) -> None:
        """End motions and slave mode at once; calls that wait for them answer `code`.

        Unless a client is told by that, the next slvMove answers it (issues 20 and 49 of
        DENSORobot/denso_robot_ros), and those after it that slave mode is off (issues 6 and 42).
        """
        self.slave.leave(0 if is_reported else code)
        self.arm.halt(now)
        self.equipment.stop(now)
        self.stop_count += 1
        self.stopped_by = code
        self.current_move = None

    def raise_error(self, code: int, now: int, is_reported: bool = False) -> None:
        """Have an error: motions and slave mode end, RobSlave stops, it stays active until ClearError.

        The motor goes off at level 4 and above, and with a set point beyond a limit (list of controller
        errors in nkawa/Denso_CobottaPro900_MQTT_Control). `is_reported` is as for `stop`.
        """
        self.alarms.add(code, now)
        self.stop(now, code, is_reported)
        if ROBSLAVE.casefold() in self.tasks:
            self.tasks[ROBSLAVE.casefold()] = READY
        if error_level(code) >= 4 or code & ~0xF == POSITION_LIMIT or code == EMERGENCY_STOP:
            self._lose_power()

    def refuse(self, code: int, now: int) -> NoReturn:
        """Refuse a call with an error that stays active until ClearError; its effects are those of
        `raise_error`.

        The error is listed once, however often the client repeats the call: 32 set points in a row would
        otherwise push the error that ended slave mode out of the list.

        A real RC8 lists 83500121 and 83501032 as current errors (DENSORobot/denso_robot_ros issue 42). That
        an RC7 does the same is assumed from DENSO Wave 2009, How to use the Slave mode: any result other than
        S_OK stops RobSlave and ends slave mode.

        Raises:
            RefusedError: always, with `code`.
        """
        if not self.alarms.is_active(code):
            self.raise_error(code, now, is_reported=True)
        raise RefusedError(code)

    def clear_errors(self) -> None:
        """Clear the active errors; slvMove does not answer a cleared one."""
        self.alarms.clear()
        self.slave.unreported_result = 0

    def switch_mode(self, mode: int, now: int) -> None:
        """Turn the mode switch; leaving the automatic mode ends all motion and switches the motor off."""
        self.mode = mode
        if mode != AUTOMATIC:
            self._lose_power()
            self.stop(now, NOT_AUTOMATIC, is_reported=False)

    def start_task(self, name: str) -> None:
        """Start a program.

        Raises:
            RefusedError: as `check_state`.
        """
        self.check_state()
        self.tasks[name.casefold()] = RUNNING

    def stop_task(self, name: str, now: int) -> None:
        """Stop a program; slave mode of RC7 ends with RobSlave."""
        self.tasks[name.casefold()] = READY
        if name.casefold() == ROBSLAVE.casefold() and self.profile.needs_robslave and self.slave.mode:
            self.stop(now, E_NOT_IN_SLAVE_MODE)

    def press_emergency_stop(self, now: int) -> None:
        """Press the emergency stop: the motor goes off, and nothing moves until it is let go."""
        self.emergency = True
        self.raise_error(EMERGENCY_STOP, now)

    def advance(self, now: int) -> None:
        """Let time pass."""
        slave, log = self.slave, self.log
        if slave.mode is not None and slave.next_tick <= now:
            fault = slave.advance(now)
            if fault:
                self.raise_error(fault.code, fault.time)
        if log.due is not None:
            log.advance(now, self._sample_log)
        collision = self.equipment.hand.collides_at
        if collision is not None and collision <= now:
            self.equipment.hand.stop(collision, HAND_DEVIATION)
            self.raise_error(HAND_DEVIATION, collision)

    def due(self) -> int | None:
        """Return when time changes something by itself, in ns; None if nothing is under way."""
        slave = self.slave
        due = None if slave.mode is None or slave.is_empty else slave.next_tick
        collision = self.equipment.hand.collides_at
        return due if collision is None else collision if due is None else min(due, collision)

    def _lose_power(self) -> None:
        self._motor_at = None
        self.equipment.lose_power()

    def _sample_log(self, time: int) -> ControlLogRecord:
        return ControlLogRecord(time - self.started_at, self.arm.commanded(time), self.arm.actual(time))
