"""What the desk tells the screen, in the desk's own threads: the screen brings it to its own."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from bcapscope.client.target import Target
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.halt import HaltNews
from bcapscope.tui.desk.record import Record


class Step(StrEnum):
    """A step of the guided connect."""

    LINK = "link"
    SERVICE = "service"
    CONTROLLER = "controller"
    IDENTITY = "identity"
    ROBOT = "robot"


@dataclass(frozen=True, slots=True)
class StepNews:
    """A step of the guided connect begins or has ended.

    Attributes:
        step: which.
        done: how it ended; None while it runs.
        text: what was found, or why it failed.
    """

    step: Step
    done: bool | None
    text: str = ""


@dataclass(frozen=True, slots=True)
class Identity:
    """What the controller says of itself.

    Attributes:
        simulator: it is our own.
        version: of its software; empty where it does not say.
        type_name: of the robot; empty until a robot is open, and where it does not say.
        type_number: likewise, value of @TYPE.
    """

    simulator: bool = False
    version: str = ""
    type_name: str = ""
    type_number: str = ""


@dataclass(frozen=True, slots=True)
class Status:
    """All that the screen shows at all times.

    Attributes:
        target: the controller; None while there is no connection.
        identity: of the controller.
        open: what is open, in the order in which it was opened.
        robot: the one that commands go to.
        slave_mode: number of the mode that the robot is in as far as our own calls tell.
        holds_arm: our TakeArm was answered, and no GiveArm since; an error may have taken the arm back.
        round_trip: ns, of the last call that was answered.
    """

    target: Target | None = None
    identity: Identity = Identity()
    open: tuple[Opened, ...] = ()
    robot: Opened | None = None
    slave_mode: int = 0
    holds_arm: bool = False
    round_trip: int = 0

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection."""
        return self.target is not None


@dataclass(frozen=True, slots=True)
class Lost:
    """The connection is gone without our doing; why, in words."""

    reason: str


@dataclass(frozen=True, slots=True)
class WatchNews:
    """Watched variables have been read."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something of the desk's own does not work, such as the action log; in words."""

    text: str


News: TypeAlias = StepNews | Status | Record | Lost | HaltNews | WatchNews | Trouble
