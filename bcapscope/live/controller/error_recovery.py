"""Recovery after an error: read the errors, clear them, and return to slave mode (DENSO Wave 2009, How to use
the Slave mode, Clearing errors). Clearing deletes the errors.
"""

from __future__ import annotations

from enum import StrEnum

from bcapscope.client.controller_errors import clear_errors, read_errors
from bcapscope.client.remote_objects import PTP, Controller
from bcapscope.client.session import command_of
from bcapscope.live.controller.controller_session import ControllerSession
from bcapscope.live.controller.guided_connect import start_robslave
from bcapscope.live.controller.history_record import HistoryRecord, Initiator, RecordOutcome
from bcapscope.protocol.codec.variant import integer_value
from bcapscope.protocol.slave_mode.modes import pose_type_of_mode
from bcapscope.protocol.slave_mode.poses import pose_numbers


class RecoveryStep(StrEnum):
    READ = "read"
    CLEAR = "clear"
    ROBSLAVE = "robslave"
    MOTOR = "motor"
    """Errors of level 4 and above switch the motor off. The step `MOTOR` switches the motor on again."""
    FIRST_POSITION = "first"
    MODE = "mode"


class LastSlaveSession:
    """The latest slave-mode session. After an error, the user usually wants to continue this session.

    Attributes:
        mode: Number of the slave mode; 2 (joints, Sync) if there was no session yet.
        first_set_point: First set point of the session; () if there was no set point yet.
    """

    def __init__(self) -> None:
        self.mode = 2
        self.first_set_point: tuple[float, ...] = ()

    def on_record(self, record: HistoryRecord) -> None:
        if record.outcome is not RecordOutcome.ANSWERED or len(record.arguments) < 3:
            return
        command, parameter = command_of(record.function_id, record.arguments), record.arguments[2]
        if command == "slvchangemode" and (mode := integer_value(parameter)):
            self.mode, self.first_set_point = mode, ()
        elif command == "slvmove" and not self.first_set_point:
            self.first_set_point = pose_numbers(parameter) or ()

    @property
    def move_position(self) -> str:
        """The first set point, as text for `Robot_Move` with `@E` (exact stop); "" if there is none."""
        kind = pose_type_of_mode(self.mode)
        if kind is None or not self.first_set_point:
            return ""
        return f"@E {kind}({','.join(f'{value:.5f}' for value in self.first_set_point)})"


async def read_current_errors(session: ControllerSession) -> tuple[tuple[int, str], ...]:
    """Read the controller's current errors, newest first, each with its code and the controller's text.

    First leave slave mode, because a call that reads errors may end slave mode abruptly (public issues of
    DENSORobot/denso_robot_ros). Raises the exceptions of `ControllerSession.call`.
    """
    if session.status.slave_mode and session.status.robot is not None:
        await run_recovery_step(session, RecoveryStep.MODE, "", 0)
    return await session.run_calls(read_errors(_controller(session)), Initiator.USER)


async def run_recovery_step(
    session: ControllerSession, recovery_step: RecoveryStep, first_position: str, mode: int
) -> HistoryRecord:
    """Run one recovery step, and return the record of its last call. `first_position` is in the notation of
    Robot_Move. Raises the exceptions of `ControllerSession.call`.
    """
    if recovery_step is RecoveryStep.CLEAR:
        return await session.record_calls(clear_errors(_controller(session)))
    if recovery_step is RecoveryStep.ROBSLAVE:
        return await start_robslave(session)
    robot = session.selected_robot()
    if recovery_step is RecoveryStep.FIRST_POSITION:
        return await session.record_calls(robot.move(PTP, first_position))
    if recovery_step is RecoveryStep.MOTOR:
        return await session.record_calls(robot.execute("Motor", 1))
    return await session.record_calls(robot.slv_change_mode(mode))


def _controller(session: ControllerSession) -> Controller:
    return Controller(session.opener.session, session.controller.handle)
