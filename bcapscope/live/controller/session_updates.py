"""Updates that the threads of the Tester's session send to the screen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TypeAlias

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.client.session import command_of, requested_slave_mode
from bcapscope.live.controller.halt_connection import HaltUpdate
from bcapscope.live.controller.history_record import HistoryRecord, Reason, RecordOutcome
from bcapscope.protocol.tables.hresult import E_NOT_IN_SLAVE_MODE, describe_hresult

_ARM_COMMANDS = ("takearm", "givearm")
_LEVEL_THAT_ENDS_SLAVE_MODE = 3


class ConnectStep(StrEnum):
    LINK = "link"
    SERVICE = "service"
    CONTROLLER = "controller"
    IDENTITY = "identity"
    ROBOT = "robot"


@dataclass(frozen=True, slots=True)
class ConnectStepUpdate:
    """A step of connecting has started (`done` is None), succeeded or failed."""

    step: ConnectStep
    done: bool | None
    result: Reason = ()


@dataclass(frozen=True, slots=True)
class ControllerIdentity:
    """What the controller reported about itself and its robot. A text is "" if the controller did not report
    it. `type_name` and `type_number` describe the robot.
    """

    is_simulator: bool = False
    version: str = ""
    type_name: str = ""
    type_number: str = ""


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """State of a controller session, always visible on the screen.

    Attributes:
        open_objects: Open objects in the order in which they were opened.
        robot: Robot to which the session sends robot commands.
        slave_mode: Number of the slave mode, derived from this client's own calls; 0 if slave mode is off.
        holds_arm: Whether TakeArm succeeded, without a later GiveArm. An error may have released the arm.
        round_trip: Round trip in ns of the last answered call.
    """

    target: ControllerTarget | None = None
    identity: ControllerIdentity = ControllerIdentity()
    open_objects: tuple[ObjectHandle, ...] = ()
    robot: ObjectHandle | None = None
    slave_mode: int = 0
    holds_arm: bool = False
    round_trip: int = 0

    @property
    def is_connected(self) -> bool:
        return self.target is not None

    def after_call(self, record: HistoryRecord, open_objects: tuple[ObjectHandle, ...]) -> SessionStatus:
        command = command_of(record.function_id, record.arguments)
        answered = record.outcome is RecordOutcome.ANSWERED
        mode = _slave_mode_after(record)
        return replace(
            self,
            open_objects=open_objects,
            robot=self.robot if self.robot in open_objects else None,
            slave_mode=self.slave_mode if mode is None else mode,
            holds_arm=command == "takearm" if answered and command in _ARM_COMMANDS else self.holds_arm,
            round_trip=self.round_trip if record.reply is None else record.took,
        )


def _slave_mode_after(record: HistoryRecord) -> int | None:
    if record.outcome is RecordOutcome.ANSWERED:
        return requested_slave_mode(record.function_id, record.arguments)
    if record.outcome is RecordOutcome.REFUSED and record.reply is not None:
        code = record.reply.code
        level = describe_hresult(code).level or 0
        # An error of level 3 or above always ends slave mode. On RC7, any result except S_OK ends slave mode
        # (DENSO Wave 2009).
        return 0 if code == E_NOT_IN_SLAVE_MODE or level >= _LEVEL_THAT_ENDS_SLAVE_MODE else None
    return None


@dataclass(frozen=True, slots=True)
class ConnectionLost:
    reason: Reason


@dataclass(frozen=True, slots=True)
class WatchUpdate:
    """Watched variables were read."""


@dataclass(frozen=True, slots=True)
class SessionProblem:
    """A part of the session failed, such as writing the action log to `path`. Calls still work."""

    path: Path
    reason: Reason


SessionUpdate: TypeAlias = (
    ConnectStepUpdate
    | SessionStatus
    | HistoryRecord
    | ConnectionLost
    | HaltUpdate
    | WatchUpdate
    | SessionProblem
)
