"""After an error: what the controller shows, read before it is cleared, and the way back to slave mode.

The sequence is that of DENSO Wave 2009, How to use the Slave mode (Clearing errors): clear, start RobSlave
again, go to the first position, change to slave mode. Clearing destroys the evidence, so reading comes first.
"""

from __future__ import annotations

from enum import StrEnum

from bcapscope.client.session import command_of
from bcapscope.protocol.codec.variant import EMPTY, VT, Value, Variant, integer_value
from bcapscope.protocol.slave_mode.modes import pose_type_of_mode
from bcapscope.protocol.slave_mode.poses import pose_numbers
from bcapscope.protocol.tables.hresult import describe_hresult
from bcapscope.tui.controller_access.controller_session import (
    ControllerSession,
    NotConnectedError,
    handle_argument,
)
from bcapscope.tui.controller_access.guided_connect import start_robslave
from bcapscope.tui.controller_access.history_record import HistoryRecord, RecordOutcome
from bcapscope.tui.words import say

MAX_ERRORS = 20
"""Errors that are read; the newest come first."""

_PTP = Variant(VT.I4, 1)


class RecoveryStep(StrEnum):
    """A step of the sequence, in its order."""

    READ = "read"
    CLEAR = "clear"
    ROBSLAVE = "robslave"
    MOTOR = "motor"
    """Errors of level 4 and above switch it off."""
    FIRST_POSITION = "first"
    MODE = "mode"


class LastSlaveSession:
    """The last stay in slave mode, which is what one wants back after an error.

    Attributes:
        mode: number of it; joints, Sync, until there was one.
        first_set_point: its first set point; () until there was one.
    """

    def __init__(self) -> None:
        self.mode = 2
        self.first_set_point: tuple[float, ...] = ()

    def on_record(self, record: HistoryRecord) -> None:
        """Learn from a call, whoever made it; one that was refused tells nothing of the robot."""
        if record.outcome is not RecordOutcome.ANSWERED or len(record.arguments) < 3:
            return
        command, parameter = command_of(record.function_id, record.arguments), record.arguments[2]
        if command == "slvchangemode" and (mode := integer_value(parameter)):
            self.mode, self.first_set_point = mode, ()
        elif command == "slvmove" and not self.first_set_point:
            self.first_set_point = pose_numbers(parameter) or ()

    @property
    def move_position(self) -> str:
        """The set point as Robot_Move takes a position, to be reached exactly; "" where there is none."""
        kind = pose_type_of_mode(self.mode)
        if kind is None or not self.first_set_point:
            return ""
        return f"@E {kind}({','.join(f'{value:.5f}' for value in self.first_set_point)})"


async def read_errors(session: ControllerSession) -> list[tuple[int, str]]:
    """Read the errors that the controller shows, newest first: code and its own text.

    In slave mode nothing else may be asked (public issues of DENSORobot/denso_robot_ros), so that is left.

    Raises:
        BcapError, OSError: as `ControllerSession.call`.
    """
    if session.status.slave_mode and session.status.robot is not None:
        await run_recovery_step(session, RecoveryStep.MODE, "", 0)
    count = _first_value(await _execute_on_controller(session, "GetCurErrorCount"))
    errors = []
    for index in range(min(count if isinstance(count, int) else 0, MAX_ERRORS)):
        info = _first_value(await _execute_on_controller(session, "GetCurErrorInfo", Variant(VT.I4, index)))
        errors.append(_parse_error_info(info))
    return errors


async def run_recovery_step(
    session: ControllerSession, recovery_step: RecoveryStep, first_position: str, mode: int
) -> HistoryRecord:
    """Do one step; return the record of its call.

    Args:
        session: that is connected.
        recovery_step: step.
        first_position: position to go to, as Robot_Move takes it.
        mode: of slvChangeMode.

    Raises:
        BcapError, OSError: as `ControllerSession.call`.
    """
    if recovery_step is RecoveryStep.CLEAR:
        return await _execute_on_controller(session, "ClearError")
    if recovery_step is RecoveryStep.ROBSLAVE:
        return await start_robslave(session)
    robot = session.status.robot
    if robot is None:
        raise NotConnectedError(say("desk.robot.missing"))
    handle = handle_argument(robot)
    if recovery_step is RecoveryStep.FIRST_POSITION:
        return await session.invoke(
            "Robot_Move", handle, _PTP, Variant(VT.BSTR, first_position), Variant(VT.BSTR, "")
        )
    motor = recovery_step is RecoveryStep.MOTOR
    command, value = ("Motor", 1) if motor else ("slvChangeMode", mode)
    values = (handle, Variant(VT.BSTR, command), Variant(VT.I4, value))
    return await session.invoke("Robot_Execute", *values)


async def _execute_on_controller(
    session: ControllerSession, command: str, parameter: Variant = EMPTY
) -> HistoryRecord:
    values = (handle_argument(session.controller), Variant(VT.BSTR, command), parameter)
    return await session.invoke("Controller_Execute", *values)


def _first_value(record: HistoryRecord) -> Value:
    arguments = record.reply.arguments if record.reply and record.outcome is RecordOutcome.ANSWERED else ()
    return arguments[0].variant.value if arguments else None


def _parse_error_info(info: Value) -> tuple[int, str]:
    """Read code and text out of what GetCurErrorInfo returns."""
    items = [item.value for item in info if isinstance(item, Variant)] if isinstance(info, tuple) else []
    code = items[0] if items and isinstance(items[0], int) else 0
    text = items[1] if len(items) > 1 and isinstance(items[1], str) else describe_hresult(code).text
    return code, text
