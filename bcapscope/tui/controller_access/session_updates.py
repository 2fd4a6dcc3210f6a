"""What the desk tells the screen, in the desk's own threads: the screen brings it to its own."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.traffic.handle_table import ObjectHandle
from bcapscope.tui.controller_access.halt_connection import HaltUpdate
from bcapscope.tui.controller_access.history_record import HistoryRecord


class ConnectStep(StrEnum):
    """A step of the guided connect."""

    LINK = "link"
    SERVICE = "service"
    CONTROLLER = "controller"
    IDENTITY = "identity"
    ROBOT = "robot"


@dataclass(frozen=True, slots=True)
class ConnectStepUpdate:
    """A step of the guided connect begins or has ended.

    Attributes:
        step: which.
        done: how it ended; None while it runs.
        text: what was found, or why it failed.
    """

    step: ConnectStep
    done: bool | None
    text: str = ""


@dataclass(frozen=True, slots=True)
class ControllerIdentity:
    """What the controller says of itself.

    Attributes:
        is_simulator: it is our own.
        version: of its software; empty where it does not say.
        type_name: of the robot; empty until a robot is open, and where it does not say.
        type_number: likewise, value of @TYPE.
    """

    is_simulator: bool = False
    version: str = ""
    type_name: str = ""
    type_number: str = ""


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """All that the screen shows at all times.

    Attributes:
        target: the controller; None while there is no connection.
        identity: of the controller.
        open_objects: what is open, in the order in which it was opened.
        robot: the one that commands go to.
        slave_mode: number of the mode that the robot is in as far as our own calls tell.
        holds_arm: our TakeArm was answered, and no GiveArm since; an error may have taken the arm back.
        round_trip: ns, of the last call that was answered.
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
        """Whether there is a connection."""
        return self.target is not None


@dataclass(frozen=True, slots=True)
class ConnectionLost:
    """The connection is gone without our doing; why, in words."""

    reason: str


@dataclass(frozen=True, slots=True)
class WatchUpdate:
    """Watched variables have been read."""


@dataclass(frozen=True, slots=True)
class SessionProblem:
    """Something of the desk's own does not work, such as the action log; in words."""

    text: str


SessionUpdate: TypeAlias = (
    ConnectStepUpdate
    | SessionStatus
    | HistoryRecord
    | ConnectionLost
    | HaltUpdate
    | WatchUpdate
    | SessionProblem
)
