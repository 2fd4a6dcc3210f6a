"""The controller's equipment besides the arm: hands, frames, areas, lines, and brackets around motions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

from bcapscope.simulator.hand import COBOTTA_HAND, TWO_FINGER_HAND, Hand
from bcapscope.simulator.result_codes import HAND_STOPPED

CoordinateFrame: TypeAlias = tuple[float, ...]
"""X, Y, Z [mm], Rx, Ry, Rz [deg]."""

MAX_FRAMES = 64
"""Numbers of tools and works, 0 to 63; assumed."""

MAX_AREAS = 32
MAX_LINES = 256


@dataclass(slots=True)
class Equipment:
    """The state of one controller's equipment.

    Attributes:
        hand: COBOTTA's electric hand, which is also the extension `Hand0`.
        gripper: the 2FG hand.
        vacuum: power of COBOTTA's vacuum hand in percent; 0 while it is off.
        tools: definitions by number; what is missing is all zeros.
        works: the same.
        areas: numbers of the areas that are on.
        lines: numbers of the serial and socket lines that are open.
        brackets: names of the open brackets around motions, `time` and `move`.
        force_control: number of the force control that is on; None for none.
    """

    hand: Hand
    gripper: Hand
    vacuum: float = 0.0
    tools: dict[int, CoordinateFrame] = field(default_factory=dict)
    works: dict[int, CoordinateFrame] = field(default_factory=dict)
    areas: set[int] = field(default_factory=set)
    lines: set[int] = field(default_factory=set)
    brackets: set[str] = field(default_factory=set)
    force_control: int | None = None

    @classmethod
    def with_object(cls, object_width: float | None) -> Equipment:
        """Make the equipment of a controller with an object of this width [mm] between its fingers."""
        return cls(Hand(COBOTTA_HAND, object_width), Hand(TWO_FINGER_HAND, object_width))

    def stop(self, now: int) -> None:
        """Stop everything that moves."""
        self.hand.stop(now, HAND_STOPPED)
        self.gripper.stop(now, HAND_STOPPED)

    def lose_power(self) -> None:
        """Lose what needs the motor's power: COBOTTA's hand its grip (error 80500371), and force control."""
        self.hand.lose_grip()
        self.vacuum = 0.0
        self.force_control = None
