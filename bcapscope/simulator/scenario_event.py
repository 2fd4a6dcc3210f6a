"""Events that happen at a controller without a request from a client, such as the emergency stop.

Events have the same notation as faults of messages. In a scenario file, the field `action` holds the name of
the event or fault.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, TypeAlias

from msgspec import Meta

from bcapscope.faults.document import FieldError
from bcapscope.faults.fault import Count, Fault
from bcapscope.faults.quantities import HresultQuantity
from bcapscope.messages import Message
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.simulator.arm import TimedMove
from bcapscope.simulator.kinematics import AXIS_COUNT, pad_joints
from bcapscope.simulator.machine import AUTOMATIC, MANUAL, OTHER_CLIENT, TEACH_CHECK
from bcapscope.simulator.simulator import Simulator, SimulatorOutput
from bcapscope.traffic.observation import Direction

LONGEST_NAME = 60

Angle: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]
Percent: TypeAlias = Annotated[float, Meta(ge=0.1, le=100)]
Joints6: TypeAlias = Annotated[tuple[Angle, ...], Meta(min_length=AXIS_COUNT, max_length=AXIS_COUNT)]


class OperatingMode(StrEnum):
    """Positions of the mode switch; `number` is the value of `Machine.mode`."""

    MANUAL = "manual"
    TEACH_CHECK = "teach-check"
    AUTOMATIC = "automatic"

    @property
    def number(self) -> int:
        return {"manual": MANUAL, "teach-check": TEACH_CHECK, "automatic": AUTOMATIC}[self]


class ScenarioEvent(Fault, frozen=True, kw_only=True):
    """Fields of all events.

    An event with a condition or an attempt number happens just before the controller gets a matching request,
    at most `times` times. Any other event happens once, when the time `after` has passed.
    """

    direction: Direction | None = Direction.REQUEST
    times: Count | None = 1

    def __post_init__(self) -> None:
        if self.direction is not Direction.REQUEST:
            raise FieldError(("direction",), Message("scenario.requests-only"))
        if not self.is_timed:
            return
        needless = {
            "times": self.times != 1,
            "probability": self.probability < 1,
            "for": self.lasts is not None,
        }
        for name, is_given in needless.items():
            if is_given:
                raise FieldError((name,), Message("scenario.needs-if"))

    @property
    def is_timed(self) -> bool:
        return self.when is None and self.attempt is None


class EmergencyStop(ScenarioEvent, frozen=True, kw_only=True, tag="emergency-stop"):
    """Somebody presses the emergency stop, and it stays pressed."""

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.press_emergency_stop(now)


class ReleaseEmergencyStop(ScenarioEvent, frozen=True, kw_only=True, tag="let-go"):
    """Somebody releases the emergency stop; its error remains active until ClearError."""

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.emergency = False


class MotorOff(ScenarioEvent, frozen=True, kw_only=True, tag="motor-off"):
    """Somebody switches the motor off, or opens a door that switches the motor off."""

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.switch_motor(False, now)


class RaiseError(ScenarioEvent, frozen=True, kw_only=True, tag="error"):
    code: HresultQuantity

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_failure(self.code):
            raise FieldError(("code",), Message("scenario.no-error", code=self.code.text))

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.raise_error(self.code, now)


class SwitchMode(ScenarioEvent, frozen=True, kw_only=True, tag="mode"):
    to: OperatingMode

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.switch_mode(self.to.number, now)


class StopTask(ScenarioEvent, frozen=True, kw_only=True, tag="stop-task"):
    task: Annotated[str, Meta(min_length=1, max_length=LONGEST_NAME)]

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.stop_task(self.task, now)


class TakeArm(ScenarioEvent, frozen=True, kw_only=True, tag="take-arm"):
    """A client on another network, or the pendant, takes the arm."""

    def apply(self, simulator: Simulator, now: int) -> None:
        simulator.machine.owner = OTHER_CLIENT


class MoveArm(ScenarioEvent, frozen=True, kw_only=True, tag="move"):
    """Somebody else moves the arm at `speed` percent, unless slave mode is on or a motion is paused."""

    joints: Joints6
    speed: Percent = 100.0

    def apply(self, simulator: Simulator, now: int) -> None:
        machine = simulator.machine
        if machine.slave.mode is None and not machine.is_held:
            machine.current_move = TimedMove(machine.arm, pad_joints(self.joints), now, self.speed / 100)


class ResetController(ScenarioEvent, frozen=True, kw_only=True, tag="reset"):
    """Somebody presses Reset on the pendant: the controller forgets all clients and closes connections."""

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
