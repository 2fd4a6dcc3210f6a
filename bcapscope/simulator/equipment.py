"""The controller's equipment besides the arm: hands, frames, areas, lines, and brackets around motions."""

from __future__ import annotations

from typing import TypeAlias

from bcapscope.simulator.hand import COBOTTA_HAND, TWO_FINGER_HAND, Hand
from bcapscope.simulator.result_codes import HAND_STOPPED

CoordinateFrame: TypeAlias = tuple[float, ...]
"""Position and orientation of a coordinate frame: X, Y, Z [mm], Rx, Ry, Rz [deg]."""

MAX_FRAMES = 64
"""Number of tool frames, and of work frames. Tool frames, and work frames, are numbered 0 to 63. The limit is
assumed."""

MAX_AREAS = 32
MAX_LINES = 256


class Equipment:
    """The state of one controller's equipment.

    Attributes:
        hand: COBOTTA's electric hand, which is also the extension `Hand0`.
        gripper: The 2FG hand.
        vacuum: Power of COBOTTA's vacuum hand in percent; 0 while it is off.
        tools: Definitions of tools by number; a missing tool is all zeros. `works` holds those of works.
        lines: Numbers of the open serial and socket lines.
        brackets: Names of the open brackets around motions: `time` and `move`.
        force_control: Number of the active force control; None if force control is off.
    """

    def __init__(self, object_width: float | None) -> None:
        """`object_width` is the width in mm of an object between the fingers; None for no object."""
        self.hand = Hand(COBOTTA_HAND, object_width)
        self.gripper = Hand(TWO_FINGER_HAND, object_width)
        self.vacuum = 0.0
        self.tools: dict[int, CoordinateFrame] = {}
        self.works: dict[int, CoordinateFrame] = {}
        self.areas: set[int] = set()
        self.lines: set[int] = set()
        self.brackets: set[str] = set()
        self.force_control: int | None = None

    def stop(self, now: int) -> None:
        self.hand.stop(now, HAND_STOPPED)
        self.gripper.stop(now, HAND_STOPPED)

    def lose_power(self) -> None:
        """Switch off force control and the hand's grip, which need the motor's power (error 80500371)."""
        self.hand.lose_grip()
        self.vacuum = 0.0
        self.force_control = None
