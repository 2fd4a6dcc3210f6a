"""The calls before and after a play: identify, run RobSlave, take the arm, switch the motor, approach.

Sources: DENSO Wave 2009, How to use the Slave mode (RC7); ShoheiKobata/orin_bcap_python_samples and
DENSORobot/denso_robot_ros2 denso_robot_core (RC8 and later).
"""

from __future__ import annotations

from collections.abc import Callable
from math import degrees, isfinite

import numpy as np

from bcapscope.client.controller_errors import clean_text, clear_errors, read_errors
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.remote_object import required_variant
from bcapscope.client.remote_objects import ONE_CYCLE, PTP, Controller, Robot, Task
from bcapscope.errors import ControllerError, RemoteProtocolError
from bcapscope.messages import Message
from bcapscope.messages.places import Quantity
from bcapscope.player.motion_checks import POSITION_TOLERANCE
from bcapscope.player.player_messages import TYPE_NAME_FACT, CleanupTask, SetPointValues
from bcapscope.player.smooth_curve import matches_posture, paired_rows
from bcapscope.protocol.codec.variant import ARRAY, EMPTY, VT, Variant
from bcapscope.protocol.slave_mode.modes import Generation, PoseType
from bcapscope.protocol.slave_mode.poses import AXES, pose_numbers
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_ROBOTISBUSY, describe_hresult, hresult_name, is_failure

_MS = 1_000_000
_POLL = 50 * _MS
_ROBSLAVE_START_DELAY = 1000 * _MS  # time that DENSO's samples for RC7 wait after Task_Start
_ARRIVAL_TIMEOUT = 1000 * _MS  # a robot that stands still for this long has stopped
_RUNNING = 3  # state of a task
# retries of the call that switches the motor: switching on takes up to two minutes, switching off takes less
_ON_RETRIES, _OFF_RETRIES = 119, 29
_MACHINE_LOCK = (0x81501005, 0x81201705, 0x81201748)
_E_SWITCHING_OFF = 0x8350106E
_SWITCH_OFF_TIMEOUT = 5000 * _MS

_POSES = {
    PoseType.P: ("@CURRENT_POSITION", "CurPos"),
    PoseType.J: ("@CURRENT_ANGLE", "CurJnt"),
    PoseType.T: ("@CURRENT_TRANS", "CurTrn"),
}
"""For each pose type, the variable that holds the robot's pose, and the command that returns the pose."""

_FACTS = (
    (TYPE_NAME_FACT, ObjectClass.ROBOT, "@TYPE_NAME"),
    ("type", ObjectClass.ROBOT, "@TYPE"),
    ("version", ObjectClass.CONTROLLER, "@VERSION"),
)


class RobotAdapter:
    """A controller with its robot. Every method raises the exceptions of `Session.call`.

    If a controller reports joints as VT_R4, it is an RC7, as DENSO's slides show. `facts` holds what the
    controller reports about itself and the robot.
    """

    robot: Robot

    def __init__(self, opener: ObjectOpener, pause: Callable[[int], None]) -> None:
        """`opener` opens the controller's objects; `pause` waits for a number of ns."""
        self.is_simulator = False
        self.generation = Generation.RC8
        self.facts: dict[str, str] = {}
        self._opener = opener
        self._pause = pause
        self._read_by_command: set[PoseType] = set()

    @property
    def real_type(self) -> VT:
        return VT.R4 if self.generation is Generation.RC7 else VT.R8

    async def connect(self) -> None:
        """Connect and open the robot; send no other calls."""
        self.robot = await self._opener.open_remote(Robot)

    async def identify(self) -> None:
        """Connect and identify the controller and the robot, without changing anything."""
        self.is_simulator = await self._opener.is_simulator()
        await self.connect()
        for name, owner, variable in _FACTS:
            found = await self._read_optional(owner, variable)
            if found is not None and found.value is not None:
                self.facts[name] = clean_text(found.value)
        joints = await self._read_pose_value(PoseType.J)
        self.generation = Generation.RC7 if joints.vt == ARRAY | VT.R4 else Generation.RC8

    async def read_pose(self, kind: PoseType) -> SetPointValues:
        """Return the current pose of the robot, or raise RemoteProtocolError if the reply holds none."""
        row = pose_numbers(await self._read_pose_value(kind))
        if row is None or len(row) < 6 or not all(map(isfinite, row)):
            raise RemoteProtocolError(Message("play.no-pose", kind=kind), b"")
        return tuple(row[: len(AXES[kind])])

    async def read_slave_mode(self) -> int:
        """Return the current slave mode; 0 if slave mode is off or the controller refuses the call."""
        try:
            return await self.robot.slv_get_mode()
        except (ControllerError, RemoteProtocolError):
            return 0

    async def clean_up(self, task: CleanupTask) -> None:
        if task is CleanupTask.ROBSLAVE:
            await (await self._opener.open_remote(Task)).stop(1)
        elif task is CleanupTask.ARM:
            await self.robot.execute("GiveArm")
        elif task is CleanupTask.MOTOR:
            await self._switch_motor(False, _OFF_RETRIES)
        elif task is CleanupTask.LOG:
            await self.robot.execute("StopLog")
        elif task is CleanupTask.SLAVE_MODE:
            await self.robot.slv_change_mode(0)

    async def is_robslave_ready(self) -> bool:
        """On RC7, return whether RobSlave runs. On other controllers, return True, because their slave mode
        needs no RobSlave.
        """
        if self.generation is not Generation.RC7:
            return True
        await self._opener.open_remote(Task)
        state = await self._read_optional(ObjectClass.TASK, "@STATUS")
        return state is not None and state.value == _RUNNING

    async def start_robslave(self) -> None:
        await (await self._opener.open_remote(Task)).start(ONE_CYCLE)
        self._pause(_ROBSLAVE_START_DELAY)

    async def take_arm(self) -> None:
        """Take the arm, and keep the current tool and work coordinates."""
        await self.robot.execute("TakeArm", [0, 1])

    async def is_motor_on(self) -> bool:
        state = await self._read_optional(ObjectClass.ROBOT, "@SERVO_ON")
        return state is not None and bool(state.value)

    async def motor_on(self) -> None:
        """If the motor is just switching off, wait until it is off, then switch it on."""
        for _ in range(_SWITCH_OFF_TIMEOUT // _POLL):
            try:
                return await self._switch_motor(True, _ON_RETRIES)
            except ControllerError as error:
                if error.hresult != _E_SWITCHING_OFF:
                    raise
            self._pause(_POLL)
        await self._switch_motor(True, _ON_RETRIES)

    async def _switch_motor(self, on: bool, retries: int) -> None:
        """Switch the motor on or off, with at least `retries` retries. DENSO's slides recommend the machine
        lock for experiments. A refusal by the machine lock is no error, because the lock prevents motion
        anyway.
        """
        parameter = Variant(VT.I2, int(on))
        if self.generation is not Generation.RC7:
            parameter = Variant.array(VT.I4, (int(on), 0))
        session = self._opener.session
        usual = session.retry_policies
        more = usual.others._replace(retries=max(retries, usual.others.retries))
        session.retry_policies = usual._replace(others=more)
        try:
            await self.robot.execute("Motor", parameter)
        except ControllerError as error:
            if error.hresult not in _MACHINE_LOCK:
                raise
        finally:
            session.retry_policies = usual

    async def approach(self, kind: PoseType, goal: SetPointValues, percent: float) -> None:
        """Move to a pose by an ordinary motion with the final pass motion @E, as slave mode requires.

        The option NEXT makes the controller answer at once, so that the player can halt the robot on its way.
        If the robot stops before the goal, raise the controller's error or, if there is none,
        RemoteProtocolError. If the robot reaches the position with another Fig than the goal's, return after
        one second without an error.
        """
        pose = f"@E {kind}({', '.join(map(_decimal, goal))})"
        while True:
            try:
                await self.robot.move(PTP, pose, f"SPEED={percent:g},NEXT")
                break
            except ControllerError as error:
                if error.hresult != E_ROBOTISBUSY:
                    raise
            self._pause(_POLL)
        still = 0
        while still < _ARRIVAL_TIMEOUT // _POLL:
            self._pause(_POLL)
            busy = await self._opener.read_variable(ObjectClass.ROBOT, "@BUSY_STATUS")
            if busy.value:
                still = 0
                continue
            here = await self.read_pose(kind)
            far = pose_distance(kind, here, goal)
            if far <= POSITION_TOLERANCE and matches_posture(kind, here, goal):
                return
            still += 1
        if far > POSITION_TOLERANCE:
            distance = Quantity(far)
            for code, _ in await self.read_errors():
                if is_failure(code):
                    meaning = Message(
                        "play.approach-refused", meaning=describe_hresult(code).meaning, distance=distance
                    )
                    raise ControllerError("Robot_Move", code, hresult_name(code), meaning)
            raise RemoteProtocolError(Message("play.no-motion", distance=distance), b"")

    async def set_formats(self, kind: PoseType) -> None:
        """Make slvMove carry a pose in its request and in its reply, even if an earlier client set other
        formats. RC7 and early versions of RC8 have no formats to set.
        """
        if self.generation is Generation.RC7:
            return
        for command, value in (("slvSendFormat", 0), ("slvRecvFormat", " PJT".index(kind))):
            try:
                await self.robot.execute(command, value)
            except ControllerError:
                return

    async def start_log(self) -> None:
        await self.robot.execute("ClearLog")
        await self.robot.execute("StartLog")

    async def read_errors(self) -> tuple[tuple[int, str], ...]:
        return await read_errors(await self._opener.open_remote(Controller))

    async def clear_errors(self) -> None:
        await clear_errors(await self._opener.open_remote(Controller))

    async def _read_pose_value(self, kind: PoseType) -> Variant:
        """Read the robot's pose from a variable, or with a command if the variable is missing or EMPTY."""
        variable, command = _POSES[kind]
        if kind not in self._read_by_command:
            found = await self._read_optional(ObjectClass.ROBOT, variable)
            if found is not None and found != EMPTY:
                return found
            self._read_by_command.add(kind)
        robot = await self._opener.open_remote(Robot)
        reply = await self._opener.session.invoke("Robot_Execute", robot.handle, command, None)
        return required_variant(reply, command)

    async def _read_optional(self, object_class: ObjectClass, name: str) -> Variant | None:
        """Read a variable that only some controllers have; return None if the controller refuses."""
        try:
            return await self._opener.read_variable(object_class, name)
        except ControllerError:
            return None


def pose_distance(kind: PoseType, here: SetPointValues, there: SetPointValues) -> float:
    """Return the difference, in degrees or mm, of the axis that differs most; ignore Fig.

    Direction cosines count as angles. Compare only the axes that both poses have: RC7 may report only six
    joints.
    """
    before, after = paired_rows(kind, here, there)
    ways = zip(AXES[kind], np.abs(after - before).tolist(), strict=False)
    return max(way if axis.unit else degrees(way) for axis, way in ways if axis.name != "Fig")


def _decimal(value: float) -> str:
    """Write a number without an exponent, because no known document or sample shows exponents in a pose."""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")
