"""What happens to a controller that no client has asked for: the emergency stop, a hand on the pendant.

Each event is validated data and knows how it happens. Together with the faults of messages, whose vocabulary
they share, they are what goes wrong in a scenario; `action` tells them apart in a document.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, TypeAlias

from msgspec import Meta

from bcapscope.faults.document import FieldError
from bcapscope.faults.fault import Count, Fault
from bcapscope.faults.quantities import HresultQuantity
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.simulator.kinematics import AXIS_COUNT, pad_joints
from bcapscope.simulator.machine import AUTOMATIC, MANUAL, OTHER_CLIENT, TEACH_CHECK
from bcapscope.simulator.simulator import Simulator, SimulatorOutput
from bcapscope.simulator.timed_move import TimedMove
from bcapscope.traffic.observation import Direction

LONGEST_NAME = 60

Angle: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]
Percent: TypeAlias = Annotated[float, Meta(ge=0.1, le=100)]
Joints6: TypeAlias = Annotated[tuple[Angle, ...], Meta(min_length=AXIS_COUNT, max_length=AXIS_COUNT)]


class OperatingMode(StrEnum):
    """Positions of the mode switch."""

    MANUAL = "manual"
    TEACH_CHECK = "teach-check"
    AUTOMATIC = "automatic"

    @property
    def number(self) -> int:
        """As @MODE tells it."""
        return {
            OperatingMode.MANUAL: MANUAL,
            OperatingMode.TEACH_CHECK: TEACH_CHECK,
            OperatingMode.AUTOMATIC: AUTOMATIC,
        }[self]


class ScenarioEvent(Fault, frozen=True, kw_only=True):
    """What all events have: when they happen.

    An event with a condition or a try happens just before a request that suits is looked at; another one
    happens by itself, once.

    Attributes:
        direction: of the messages that let it happen.
        times: so often at most.
    """

    direction: Direction | None = Direction.REQUEST
    times: Count | None = 1

    def __post_init__(self) -> None:
        if self.direction is not Direction.REQUEST:
            raise FieldError(("direction",), "events happen on requests only")
        needless = {
            "times": self.times != 1,
            "probability": self.probability < 1,
            "for": self.lasts is not None,
        }
        for name, given in needless.items():
            if given and self.is_timed:
                raise FieldError((name,), "needs if or try, as the event happens by itself, and once")

    @property
    def is_timed(self) -> bool:
        """Whether it happens by itself, when `after` is over."""
        return self.when is None and self.attempt is None


class EmergencyStop(ScenarioEvent, frozen=True, kw_only=True, tag="emergency-stop"):
    """The emergency stop is pressed, and stays pressed."""

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.press_emergency_stop(now)
        return []


class ReleaseEmergencyStop(ScenarioEvent, frozen=True, kw_only=True, tag="let-go"):
    """The emergency stop is let go; its error stays until ClearError."""

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.emergency = False
        return []


class MotorOff(ScenarioEvent, frozen=True, kw_only=True, tag="motor-off"):
    """Somebody switches the motor off, or opens the door that does."""

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.switch_motor(False, now)
        return []


class RaiseError(ScenarioEvent, frozen=True, kw_only=True, tag="error"):
    """The controller has an error, which ends motions and slave mode and stays until ClearError.

    Attributes:
        code: of the error.
    """

    code: HresultQuantity

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_failure(self.code):
            raise FieldError(("code",), f"{self.code.text} is no error")

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.raise_error(self.code, now)
        return []


class SwitchMode(ScenarioEvent, frozen=True, kw_only=True, tag="mode"):
    """Somebody turns the mode switch of the pendant.

    Attributes:
        to: where to.
    """

    to: OperatingMode

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.switch_mode(self.to.number, now)
        return []


class StopTask(ScenarioEvent, frozen=True, kw_only=True, tag="stop-task"):
    """Somebody stops a program on the pendant.

    Attributes:
        task: its name.
    """

    task: Annotated[str, Meta(min_length=1, max_length=LONGEST_NAME)]

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.stop_task(self.task, now)
        return []


class TakeArm(ScenarioEvent, frozen=True, kw_only=True, tag="take-arm"):
    """The arm goes to a client on another network, or to the pendant."""

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        simulator.machine.owner = OTHER_CLIENT
        return []


class MoveArm(ScenarioEvent, frozen=True, kw_only=True, tag="move"):
    """The arm is moved by somebody else, unless set points have it or a motion is held.

    Attributes:
        joints: where to, six angles in degrees.
        speed: percent of the highest.
    """

    joints: Joints6
    speed: Percent = 100.0

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        machine = simulator.machine
        if machine.slave.mode is None and not machine.is_held:
            machine.current_move = TimedMove(machine.arm, pad_joints(self.joints), now, self.speed / 100)
        return []


class ResetController(ScenarioEvent, frozen=True, kw_only=True, tag="reset"):
    """Somebody presses Reset on the pendant: all clients are forgotten, their connections closed."""

    def apply(self, simulator: Simulator, now: int) -> list[SimulatorOutput]:
        return simulator.reset(now)


AnyEvent: TypeAlias = (
    EmergencyStop
    | ReleaseEmergencyStop
    | MotorOff
    | RaiseError
    | SwitchMode
    | StopTask
    | TakeArm
    | MoveArm
    | ResetController
)
"""Every event."""
