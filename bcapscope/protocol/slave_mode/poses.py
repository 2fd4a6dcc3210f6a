"""Poses: rows of numbers with the names and units of their axes.

Source for the pose types P and J on RC7: DENSO Wave 2009, How to use the Slave mode. The ROS driver
(DENSORobot/denso_robot_ros2 denso_robot_control) uses poses of 7 (P), 8 (J) or 10 (T) numbers. The ROS driver
appends one more number to each pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType

USED_AXES_FLAG = 0x400000
"""The ROS driver appends to each pose this number plus one bit per axis in use. The purpose is not known."""

FLOAT_ARRAYS = frozenset((int(ARRAY | VT.R8), int(ARRAY | VT.R4)))
"""VARIANT types of a pose that is an array of numbers."""


class Axis(NamedTuple):
    """Name of one number of a pose, and its unit: `mm`, `deg`, or empty for Fig and direction cosines."""

    name: str
    unit: str


def _axes_named(names: str, unit: str) -> tuple[Axis, ...]:
    return tuple(Axis(name, unit) for name in names.split())


AXES: Mapping[PoseType, tuple[Axis, ...]] = MappingProxyType(
    {
        PoseType.P: (*_axes_named("X Y Z", "mm"), *_axes_named("Rx Ry Rz", "deg"), Axis("Fig", "")),
        PoseType.J: _axes_named("J1 J2 J3 J4 J5 J6 J7 J8", "deg"),
        PoseType.T: (*_axes_named("X Y Z", "mm"), *_axes_named("Ox Oy Oz Ax Ay Az Fig", "")),
    }
)
"""Axes of each pose type, in order. The values of linear axes are in mm."""

SHORTEST_POSE: Mapping[PoseType, int] = MappingProxyType({PoseType.P: 6, PoseType.J: 6, PoseType.T: 10})
"""Minimum number of values in a pose. In P type, Fig may be missing; in J type, RC7 accepts six joints."""


class Pose(NamedTuple):
    """A pose.

    Attributes:
        type: None if the number of values fits no pose type.
        values: One number per axis of `axes`, in order.
        extra: Numbers after the values of the axes, such as the number that the ROS driver appends.
        guessed: Whether the pose type is a guess from the number of values.
    """

    type: PoseType | None
    values: tuple[float, ...]
    extra: tuple[float, ...] = ()
    guessed: bool = False

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes to which the `values` belong, in order; () if the pose type is not known."""
        return AXES[self.type][: len(self.values)] if self.type else ()

    @property
    def used_axes(self) -> int | None:
        """Axes in use according to the number that the ROS driver appends: bit 0 for J1, bit 1 for J2."""
        return (
            int(self.extra[0]) & 0xFF if len(self.extra) == 1 and is_used_axes_mark(self.extra[0]) else None
        )


def is_used_axes_mark(number: float) -> bool:
    return USED_AXES_FLAG <= number <= USED_AXES_FLAG + 0xFF and number == int(number)


def pose_numbers(variant: Variant) -> tuple[float, ...] | None:
    """Return the numbers of a number array, or of a VARIANT array that holds only numbers; None for any other
    value. Clients send a VARIANT array for a list that mixes integers and floats.
    """
    value = variant.value
    if not isinstance(value, tuple):
        return None
    if variant.vt in FLOAT_ARRAYS:
        return value  # type: ignore[return-value]  # these types hold floats
    plain = [item.value if isinstance(item, Variant) else item for item in value]
    if not all(isinstance(item, int | float) and not isinstance(item, bool) for item in plain):
        return None
    return tuple(plain)  # type: ignore[arg-type]  # the types were checked above


def guess_pose_type(values: tuple[float, ...]) -> PoseType | None:
    """Guess the pose type from the number of values. If the last value is the number that the ROS driver
    appends (see `USED_AXES_FLAG`), this value does not count.
    """
    count = len(values)
    if count and is_used_axes_mark(values[-1]):
        return {8: PoseType.P, 9: PoseType.J, 11: PoseType.T}.get(count)
    return {6: PoseType.J, 7: PoseType.P, 8: PoseType.J, 10: PoseType.T}.get(count)


def build_pose(values: tuple[float, ...], pose_type: PoseType | None) -> tuple[Pose, tuple[Message, ...]]:
    """Return a pose, and its problems. Without `pose_type`, guess the pose type from the number of values."""
    type_ = pose_type or guess_pose_type(values)
    guessed = pose_type is None
    if type_ is None:
        return Pose(None, values, (), guessed), (Message("slvmove.no-pose", n=len(values)),)
    size = len(AXES[type_])
    pose = Pose(type_, values[:size], values[size:], guessed)
    odd = pose.extra and pose.used_axes is None
    if odd or len(values) < SHORTEST_POSE[type_]:
        return pose, (Message("slvmove.pose-size", n=len(values), pose=type_.value, size=size),)
    return pose, ()
