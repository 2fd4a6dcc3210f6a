"""After an error: what the controller shows, read before it is cleared, and the way back to slave mode.

The sequence is that of DENSO Wave 2009, How to use the Slave mode (Clearing errors): clear, start RobSlave
again, go to the first position, change to slave mode. Clearing destroys the evidence, so reading comes first.
"""

from __future__ import annotations

from enum import StrEnum

from bcapscope.client.session import command_of
from bcapscope.protocol.hresult import describe
from bcapscope.protocol.poses import numbers
from bcapscope.protocol.slavemode import mode_pose_type, mode_value
from bcapscope.protocol.variant import EMPTY, VT, Value, Variant
from bcapscope.tui.desk.connecting import start_robslave
from bcapscope.tui.desk.desk import Desk, NotConnectedError, handle_variant
from bcapscope.tui.desk.record import Ending, Record
from bcapscope.tui.words import say

MOST_ERRORS = 20
"""Errors that are read; the newest come first."""

_PTP = Variant(VT.I4, 1)


class Step(StrEnum):
    """A step of the sequence, in its order."""

    READ = "read"
    CLEAR = "clear"
    ROBSLAVE = "robslave"
    MOTOR = "motor"
    """Errors of level 4 and above switch it off."""
    FIRST = "first"
    MODE = "mode"


class LastStay:
    """The last stay in slave mode, which is what one wants back after an error.

    Attributes:
        mode: number of it; joints, Sync, until there was one.
        point: its first set point; () until there was one.
    """

    def __init__(self) -> None:
        self.mode = 2
        self.point: tuple[float, ...] = ()

    def take(self, record: Record) -> None:
        """Learn from a call, whoever made it; one that was refused tells nothing of the robot."""
        if record.ending is not Ending.ANSWERED or len(record.arguments) < 3:
            return
        command, parameter = command_of(record.function_id, record.arguments), record.arguments[2]
        if command == "slvchangemode" and (mode := mode_value(parameter)):
            self.mode, self.point = mode, ()
        elif command == "slvmove" and not self.point:
            self.point = numbers(parameter) or ()

    @property
    def position(self) -> str:
        """The set point as Robot_Move takes a position, to be reached exactly; "" where there is none."""
        kind = mode_pose_type(self.mode)
        if kind is None or not self.point:
            return ""
        return f"@E {kind}({','.join(f'{value:.5f}' for value in self.point)})"


async def read_errors(desk: Desk) -> list[tuple[int, str]]:
    """Read the errors that the controller shows, newest first: code and its own text.

    In slave mode nothing else may be asked (public issues of DENSORobot/denso_robot_ros), so that is left.

    Raises:
        BcapError, OSError: as `Desk.call`.
    """
    if desk.status.slave_mode and desk.status.robot is not None:
        await step(desk, Step.MODE, "", 0)
    count = _first(await _execute(desk, "GetCurErrorCount"))
    errors = []
    for index in range(min(count if isinstance(count, int) else 0, MOST_ERRORS)):
        info = _first(await _execute(desk, "GetCurErrorInfo", Variant(VT.I4, index)))
        errors.append(_error(info))
    return errors


async def step(desk: Desk, which: Step, first: str, mode: int) -> Record:
    """Do one step; return the record of its call.

    Args:
        desk: that is connected.
        which: step.
        first: position to go to, as Robot_Move takes it.
        mode: of slvChangeMode.

    Raises:
        BcapError, OSError: as `Desk.call`.
    """
    if which is Step.CLEAR:
        return await _execute(desk, "ClearError")
    if which is Step.ROBSLAVE:
        return await start_robslave(desk)
    robot = desk.status.robot
    if robot is None:
        raise NotConnectedError(say("desk.robot.missing"))
    handle = handle_variant(robot)
    if which is Step.FIRST:
        return await desk.invoke("Robot_Move", handle, _PTP, Variant(VT.BSTR, first), Variant(VT.BSTR, ""))
    motor = which is Step.MOTOR
    command, value = ("Motor", 1) if motor else ("slvChangeMode", mode)
    values = (handle, Variant(VT.BSTR, command), Variant(VT.I4, value))
    return await desk.invoke("Robot_Execute", *values)


async def _execute(desk: Desk, command: str, parameter: Variant = EMPTY) -> Record:
    values = (handle_variant(desk.controller), Variant(VT.BSTR, command), parameter)
    return await desk.invoke("Controller_Execute", *values)


def _first(record: Record) -> Value:
    arguments = record.reply.arguments if record.reply and record.ending is Ending.ANSWERED else ()
    return arguments[0].variant.value if arguments else None


def _error(info: Value) -> tuple[int, str]:
    """Read code and text out of what GetCurErrorInfo returns."""
    items = [item.value for item in info if isinstance(item, Variant)] if isinstance(info, tuple) else []
    code = items[0] if items and isinstance(items[0], int) else 0
    text = items[1] if len(items) > 1 and isinstance(items[1], str) else describe(code).text
    return code, text
