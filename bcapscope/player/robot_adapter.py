"""The calls of the sequence: what is there, RobSlave, arm, motor, the first position, errors.

DENSO Wave 2009, How to use the Slave mode (RC7); ShoheiKobata/orin_bcap_python_samples and
DENSORobot/denso_robot_ros2 denso_robot_core (RC8 and later). Waiting in here is done by `pause`, which raises
when there is an order to stop.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from math import degrees, isfinite

import numpy as np

from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.remote_objects import Controller, Robot, Task, handle_of
from bcapscope.errors import ControllerError, RemoteProtocolError
from bcapscope.player.motion_checks import POSITION_TOLERANCE
from bcapscope.player.player_messages import TYPE_NAME_FACT, CleanupTask, SetPointValues
from bcapscope.player.smooth_curve import matches_posture, unwrap_rotations
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Value, Variant
from bcapscope.protocol.slave_mode.modes import Generation, PoseType
from bcapscope.protocol.slave_mode.poses import AXES, pose_numbers
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_ROBOTISBUSY, describe_hresult, hresult_name, is_failure

_MS = 1_000_000
_POLL = 50 * _MS
_ROBSLAVE_START_DELAY = 1000 * _MS  # as long as the samples for RC7 wait after Task_Start
_ARRIVAL_TIMEOUT = 1000 * _MS  # how long a robot may stand somewhere else before it counts as not on its way
_RUNNING = 3  # state of a task
_ONE_CYCLE = 1
_PTP = 1
_ON_RETRIES, _OFF_RETRIES = 119, 29  # after the first: two minutes for what takes its time, less to get away
_MAX_ERRORS = 16
_MACHINE_LOCK = (0x81501005, 0x81201705, 0x81201748)
_E_SWITCHING_OFF = 0x8350106E
_SWITCH_OFF_TIMEOUT = 5000 * _MS

_POSES = {
    PoseType.P: ("@CURRENT_POSITION", "CurPos"),
    PoseType.J: ("@CURRENT_ANGLE", "CurJnt"),
    PoseType.T: ("@CURRENT_TRANS", "CurTrn"),
}
"""By pose type: the variable of the robot, and the command that answers the same."""

_FACTS = (
    (TYPE_NAME_FACT, ObjectClass.ROBOT, "@TYPE_NAME"),
    ("type", ObjectClass.ROBOT, "@TYPE"),
    ("version", ObjectClass.CONTROLLER, "@VERSION"),
)


class RobotAdapter:
    """A controller with its robot.

    Attributes:
        robot: the arm.
        is_simulator: it is our own.
        generation: RC7 where joints come as VT_R4, as DENSO's slides show them, else RC8.
        facts: what it says of itself.
    """

    robot: Robot

    def __init__(self, opener: ObjectOpener, pause: Callable[[int], None]) -> None:
        """Use what `opener` opens; `pause` waits so many ns."""
        self.is_simulator = False
        self.generation = Generation.RC8
        self.facts: dict[str, str] = {}
        self._opener = opener
        self._pause = pause
        self._variables: dict[tuple[ObjectClass, str], int] = {}
        self._read_by_command: set[PoseType] = set()
        self._cleanups: Mapping[CleanupTask, Callable[[], Awaitable[None]]] = {
            CleanupTask.ROBSLAVE: self._stop_robslave,
            CleanupTask.ARM: self._give_arm,
            CleanupTask.MOTOR: self._motor_off,
            CleanupTask.LOG: self._stop_log,
            CleanupTask.SLAVE_MODE: self._leave_slave_mode,
        }

    @property
    def real_type(self) -> VT:
        """Type of the numbers of a pose."""
        return VT.R4 if self.generation is Generation.RC7 else VT.R8

    @property
    def needs_take_arm(self) -> bool:
        """Whether motion needs TakeArm."""
        return self.generation is not Generation.RC7

    async def connect(self) -> None:
        """Connect, and open the robot; nothing else is asked.

        Raises:
            BcapError: as `Session.call`.
        """
        self.robot = Robot(self._opener.session, await self._opener.handle_for(ObjectClass.ROBOT))

    async def identify(self) -> None:
        """Connect and find out what is there; nothing is changed.

        Raises:
            BcapError: as `Session.call`.
        """
        self.is_simulator = await self._opener.is_simulator()
        await self.connect()
        for name, owner, variable in _FACTS:
            found = await self._read_optional(owner, variable)
            if found is not None and found.value is not None:
                self.facts[name] = _text(found.value)
        joints = await self._read_pose_value(PoseType.J)
        self.generation = Generation.RC7 if joints.vt == ARRAY | VT.R4 else Generation.RC8

    async def read_pose(self, kind: PoseType) -> SetPointValues:
        """Return where the robot is.

        Raises:
            RemoteProtocolError: the answer is no pose.
            BcapError: as `Session.call`.
        """
        row = pose_numbers(await self._read_pose_value(kind))
        if row is None or len(row) < 6 or not all(map(isfinite, row)):
            raise RemoteProtocolError(f"the controller does not tell a pose of type {kind}", b"")
        return tuple(row[: len(AXES[kind])])

    async def read_slave_mode(self) -> int:
        """Return the slave mode that the robot is in; 0 for none, or where the controller does not tell."""
        try:
            return await self.robot.slv_get_mode()
        except (ControllerError, RemoteProtocolError):
            return 0

    async def clean_up(self, task: CleanupTask) -> None:
        """End what was begun.

        Raises:
            BcapError: as `Session.call`.
        """
        await self._cleanups[task]()

    async def is_robslave_ready(self) -> bool:
        """Tell whether the program runs that slave mode needs on RC7; later ones need none."""
        if self.generation is not Generation.RC7:
            return True
        await self._open_task()
        state = await self._read_optional(ObjectClass.TASK, "@STATUS")
        return state is not None and state.value == _RUNNING

    async def start_robslave(self) -> None:
        """Start the program."""
        await (await self._open_task()).start(_ONE_CYCLE)
        self._pause(_ROBSLAVE_START_DELAY)

    async def _stop_robslave(self) -> None:
        await (await self._open_task()).stop(1)

    async def _open_task(self) -> Task:
        return Task(self._opener.session, await self._opener.handle_for(ObjectClass.TASK))

    async def take_arm(self) -> None:
        """Take the arm, tool and work as they are."""
        await self.robot.execute("TakeArm", [0, 1])

    async def _give_arm(self) -> None:
        await self.robot.execute("GiveArm")

    async def is_motor_on(self) -> bool:
        """Tell whether the motor is on; it counts as off where nobody knows."""
        state = await self._read_optional(ObjectClass.ROBOT, "@SERVO_ON")
        return state is not None and bool(state.value)

    async def motor_on(self) -> None:
        """Switch the motor on, which it may just be switching off."""
        for _ in range(_SWITCH_OFF_TIMEOUT // _POLL):
            try:
                return await self._switch_motor(True, _ON_RETRIES)
            except ControllerError as error:
                if error.hresult != _E_SWITCHING_OFF:
                    raise
            self._pause(_POLL)
        await self._switch_motor(True, _ON_RETRIES)

    async def _motor_off(self) -> None:
        await self._switch_motor(False, _OFF_RETRIES)

    async def _switch_motor(self, on: bool, retries: int) -> None:
        """Switch the motor.

        With the machine lock on, which DENSO's slides recommend for trying things out, there is none to
        switch.
        """
        parameter = Variant(VT.I2, int(on))
        if self.generation is not Generation.RC7:
            parameter = Variant.array(VT.I4, (int(on), 0))
        with self._extra_retries(retries):
            try:
                await self.robot.execute("Motor", parameter)
            except ControllerError as error:
                if error.hresult not in _MACHINE_LOCK:
                    raise

    async def approach(self, kind: PoseType, goal: SetPointValues, percent: float) -> None:
        """Go to a pose by an ordinary motion, ending with @E as slave mode wants it.

        The call comes back at once (NEXT), so that the robot can be halted on the way. Where the position is
        reached and the controller goes on telling another Fig, its own word is not doubted for long.

        Raises:
            ControllerError: it stands still elsewhere, after an error.
            RemoteProtocolError: it stands still elsewhere, and the controller shows no error.
            BcapError: as `Session.call`.
        """
        pose = f"@E {kind}({', '.join(map(_decimal, goal))})"
        while True:
            try:
                await self.robot.move(_PTP, pose, f"SPEED={percent:g},NEXT")
                break
            except ControllerError as error:
                if error.hresult != E_ROBOTISBUSY:
                    raise
            self._pause(_POLL)
        still = 0
        while still < _ARRIVAL_TIMEOUT // _POLL:
            self._pause(_POLL)
            busy = await self._read_variable(ObjectClass.ROBOT, "@BUSY_STATUS")
            if busy.value:
                still = 0
                continue
            here = await self.read_pose(kind)
            far = pose_distance(kind, here, goal)
            if far <= POSITION_TOLERANCE and matches_posture(kind, here, goal):
                return
            still += 1
        if far > POSITION_TOLERANCE:
            stands = f"the robot stands {far:.3g} from the first set point"
            for code, _ in await self.read_errors():
                if is_failure(code):
                    meaning = f"{describe_hresult(code).text}; {stands}"
                    raise ControllerError("Robot_Move", code, hresult_name(code), meaning)
            raise RemoteProtocolError(f"{stands} and does not move", b"")

    async def set_formats(self, kind: PoseType) -> None:
        """Let slvMove carry a pose there and back, whatever an earlier client has set.

        RC7 has no formats, and early versions of RC8 have none either.
        """
        if self.generation is Generation.RC7:
            return
        for command, value in (("slvSendFormat", 0), ("slvRecvFormat", " PJT".index(kind))):
            try:
                await self.robot.execute(command, value)
            except ControllerError:
                return

    async def start_log(self) -> None:
        """Empty the controller's log and begin to record."""
        await self.robot.execute("ClearLog")
        await self.robot.execute("StartLog")

    async def _stop_log(self) -> None:
        await self.robot.execute("StopLog")

    async def _leave_slave_mode(self) -> None:
        await self.robot.slv_change_mode(0)

    async def read_errors(self) -> tuple[tuple[int, str], ...]:
        """Read the errors that are active, the newest first; nothing is cleared."""
        controller = Controller(self._opener.session, await self._opener.handle_for(ObjectClass.CONTROLLER))
        found: list[tuple[int, str]] = []
        try:
            count = await controller.execute("GetCurErrorCount")
            for index in range(min(count, _MAX_ERRORS) if isinstance(count, int) else 0):
                found.append(_error_info(await controller.execute("GetCurErrorInfo", index)))
        except ControllerError:
            code = await self._read_optional(ObjectClass.CONTROLLER, "@ERROR_CODE")
            text = await self._read_optional(ObjectClass.CONTROLLER, "@ERROR_DESCRIPTION")
            if code is not None and code.value:
                found.append(_error_info((code.value, text.value if text else "")))
        return tuple(found)

    async def clear_errors(self) -> None:
        """Clear them."""
        controller = Controller(self._opener.session, await self._opener.handle_for(ObjectClass.CONTROLLER))
        await controller.execute("ClearError")

    async def _read_pose_value(self, kind: PoseType) -> Variant:
        """Read a pose from its variable, or by its command where the variable is missing or EMPTY."""
        variable, command = _POSES[kind]
        if kind not in self._read_by_command:
            found = await self._read_optional(ObjectClass.ROBOT, variable)
            if found is not None and found != EMPTY:
                return found
            self._read_by_command.add(kind)
        reply = await self._opener.session.invoke("Robot_Execute", self.robot.handle, command, None)
        return _reply_value(reply, command)

    async def _read_optional(self, object_class: ObjectClass, name: str) -> Variant | None:
        """Read a variable that not every controller has."""
        try:
            return await self._read_variable(object_class, name)
        except ControllerError:
            return None

    async def _read_variable(self, object_class: ObjectClass, name: str) -> Variant:
        """Read a variable, which stays open for the next time."""
        invoke = self._opener.session.invoke
        if (object_class, name) not in self._variables:
            reply = await invoke(
                f"{object_class}_GetVariable", await self._opener.handle_for(object_class), name, ""
            )
            self._variables[object_class, name] = handle_of(reply)
        reply = await invoke("Variable_GetValue", self._variables[object_class, name])
        return _reply_value(reply, name)

    @contextmanager
    def _extra_retries(self, retries: int) -> Iterator[None]:
        """Give the calls of a block more time: so many tries after the first, or more."""
        session = self._opener.session
        usual = session.retry_policies
        more = usual.others._replace(retries=max(retries, usual.others.retries))
        session.retry_policies = usual._replace(others=more)
        try:
            yield
        finally:
            session.retry_policies = usual


def pose_distance(kind: PoseType, here: SetPointValues, there: SetPointValues) -> float:
    """Return the largest difference of an axis, deg or mm; direction cosines count as angles, Fig not.

    Axes that only one of them has do not count: RC7 may tell six joints.
    """
    width = min(len(here), len(there))
    before, after = unwrap_rotations(kind, np.vstack((here[:width], there[:width])))
    ways = zip(AXES[kind], np.abs(after - before).tolist(), strict=False)
    return max(way if axis.unit else degrees(way) for axis, way in ways if axis.name != "Fig")


def _reply_value(reply: Frame, name: str) -> Variant:
    if not reply.arguments:
        raise RemoteProtocolError(f"{name} has no value", reply.raw)
    return reply.arguments[0].variant


def _error_info(info: Value) -> tuple[int, str]:
    """Read code and text out of GetCurErrorInfo's values."""
    code, text, *_ = (*info, 0, "") if isinstance(info, tuple) else (0, str(info))
    return (code & 0xFFFFFFFF if isinstance(code, int) else 0), _text(text)


def _decimal(value: float) -> str:
    """Write a number without an exponent, which no source shows in the text of a pose."""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")


def _text(value: Value) -> str:
    """Make text of a value, "" of EMPTY; half of a surrogate pair, which no message carries, is replaced."""
    return "" if value is None else str(value).encode("utf-16", "surrogatepass").decode("utf-16", "replace")
