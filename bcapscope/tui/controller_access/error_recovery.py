"""Recovery after an error: read the errors, clear them, and return to slave mode.

The sequence is DENSO Wave 2009, How to use the Slave mode (Clearing errors): clear, start RobSlave again,
move to the first position, enter slave mode. Clearing destroys the evidence, so reading comes first.
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
"""Maximum number of errors to read; the newest come first."""

_PTP = Variant(VT.I4, 1)


class RecoveryStep(StrEnum):
    """A step of the recovery, in order."""

    READ = "read"
    CLEAR = "clear"
    ROBSLAVE = "robslave"
    MOTOR = "motor"
    """Errors of level 4 and above switch the motor off."""
    FIRST_POSITION = "first"
    MODE = "mode"


class LastSlaveSession:
    """The last slave-mode session, which the user usually wants back after an error.

    Attributes:
        mode: Number of the slave mode; joints, Sync, before the first session.
        first_set_point: Its first set point; () before the first session.
    """

    def __init__(self) -> None:
        self.mode = 2
        self.first_set_point: tuple[float, ...] = ()

    def on_record(self, record: HistoryRecord) -> None:
        """Update from a call of any initiator. A refused call shows nothing about the robot, so skip it."""
        if record.outcome is not RecordOutcome.ANSWERED or len(record.arguments) < 3:
            return
        command, parameter = command_of(record.function_id, record.arguments), record.arguments[2]
        if command == "slvchangemode" and (mode := integer_value(parameter)):
            self.mode, self.first_set_point = mode, ()
        elif command == "slvmove" and not self.first_set_point:
            self.first_set_point = pose_numbers(parameter) or ()

    @property
    def move_position(self) -> str:
        """The set point as a position for Robot_Move, to be reached exactly; "" if there is none."""
        kind = pose_type_of_mode(self.mode)
        if kind is None or not self.first_set_point:
            return ""
        return f"@E {kind}({','.join(f'{value:.5f}' for value in self.first_set_point)})"


async def read_errors(session: ControllerSession) -> list[tuple[int, str]]:
    """Read the controller's current errors, newest first: code and the controller's text.

    Leave slave mode first, where no other call is safe (public issues of DENSORobot/denso_robot_ros).

    Raises:
        BcapError, OSError: As for `ControllerSession.call`.
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
    """Run one step; return the record of its call.

    Args:
        session: Connected session.
        recovery_step: Step to run.
        first_position: Target position in the notation of Robot_Move.
        mode: Mode number for slvChangeMode.

    Raises:
        BcapError, OSError: As for `ControllerSession.call`.
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
    """Return code and text from a result of GetCurErrorInfo."""
    items = [item.value for item in info if isinstance(item, Variant)] if isinstance(info, tuple) else []
    code = items[0] if items and isinstance(items[0], int) else 0
    text = items[1] if len(items) > 1 and isinstance(items[1], str) else describe_hresult(code).text
    return code, text
