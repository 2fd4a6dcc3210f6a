"""Formats of slvMove (DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_robot.cpp and denso_robot.h)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.slave_mode.modes import PoseType

_POSE_BITS = 0x00F
_POSES: dict[int, tuple[PoseType, ...]] = {
    0: (),
    1: (PoseType.P,),
    2: (PoseType.J,),
    3: (PoseType.T,),
    4: (PoseType.P, PoseType.J),
    5: (PoseType.T, PoseType.J),
}
_DIGIT_BY_POSES = {poses: digit for digit, poses in _POSES.items()}
_SEND_BITS = {"hand_io": 0x020, "mini_io": 0x100, "user_io": 0x200}
_RECEIVE_BITS = {"timestamp": 0x010, "current": 0x040, **_SEND_BITS}

_UNDOCUMENTED_BIT = 0x400
"""Bit that open-source clients set in the send format 0x620. No public source explains the bit 0x400."""


@dataclass(frozen=True, slots=True)
class SendFormat:
    """What the parameter of slvMove holds besides the pose.

    Attributes:
        hand_io: Whether there is a hand I/O word. Bit 0 is IO48. The controller writes only IO64..IO71.
        mini_io: Whether there is a mini I/O word. Bit 0 is IO0. Some controllers write only IO24..IO31, and
            others write only IO16..IO31.
        user_io: Whether there are I/O bits to write, and the range of these bits.
        other: Bits of the format that have no known meaning.
    """

    hand_io: bool = False
    mini_io: bool = False
    user_io: bool = False
    other: int = 0

    @classmethod
    def parse(cls, value: int) -> SendFormat:
        """Decode the parameter of slvSendFormat; every number is a valid format."""
        flags, other = _split_flags(value, _SEND_BITS)
        return cls(**flags, other=other)

    def __int__(self) -> int:
        return self.other | _join_flags(self, _SEND_BITS)

    @property
    def is_known(self) -> bool:
        """Whether clients use this format: 0, 0x20, 0x100, 0x120, 0x200 or 0x220, with or without 0x400."""
        return not self.other & ~_UNDOCUMENTED_BIT and not (self.mini_io and self.user_io)


POSE_ONLY_FORMAT = SendFormat()


@dataclass(frozen=True, slots=True)
class ReceiveFormat:
    """What the result of slvMove holds.

    Attributes:
        poses: Types of the poses in order. One number array holds both poses if there are two.
        timestamp: Whether there is the time since the controller's start.
        hand_io: Whether there is a hand I/O word, whose bit 0 is IO48.
        mini_io: Whether there is a mini I/O word, whose bit 0 is IO0.
        user_io: Whether there is the range of I/O bits that slvMove requested.
        other: Bits of the format that have no known meaning; includes the last digit if it is above 5.
        microseconds: Whether the timestamp is in µs instead of ms, as the second number of slvRecvFormat's
            parameter selects.

    Raises:
        ValueError: slvRecvFormat cannot select the combination of pose types in `poses`.
    """

    poses: tuple[PoseType, ...] = ()
    timestamp: bool = False
    hand_io: bool = False
    current: bool = False
    mini_io: bool = False
    user_io: bool = False
    other: int = 0
    microseconds: bool = False

    def __post_init__(self) -> None:
        if self.poses not in _DIGIT_BY_POSES:
            raise ValueError(f"slvRecvFormat cannot select these pose types: {self.poses}")

    @classmethod
    def parse(cls, value: int, microseconds: bool = False) -> ReceiveFormat:
        """Decode the format number of slvRecvFormat; every number is a valid format."""
        poses = _POSES.get(value & _POSE_BITS)
        flags, other = _split_flags(value if poses is None else value & ~_POSE_BITS, _RECEIVE_BITS)
        return cls(poses or (), **flags, other=other, microseconds=microseconds)

    def __int__(self) -> int:
        return self.other | _DIGIT_BY_POSES[self.poses] | _join_flags(self, _RECEIVE_BITS)

    @property
    def bare_pose_type(self) -> PoseType | None:
        """Pose type of a result that holds one pose and nothing else; None for other results."""
        words = self.timestamp or self.hand_io or self.current or self.mini_io or self.user_io
        return self.poses[0] if len(self.poses) == 1 and not words else None

    @property
    def is_known(self) -> bool:
        """Whether DENSO's ROS driver knows this format. If a format has both mini I/O and user I/O, the
        driver knows it only if it also has the motor current, and nothing else besides poses: 0x340, plus the
        digit of the poses.
        """
        both = self.mini_io and self.user_io
        return not self.other and (not both or int(self) & ~_POSE_BITS == 0x340)


def _split_flags(value: int, bits: dict[str, int]) -> tuple[dict[str, bool], int]:
    """Return which of `bits` are set in `value`, and the remaining bits of `value`."""
    flags = {name: bool(value & bit) for name, bit in bits.items()}
    return flags, value & ~sum(bits.values())


def _join_flags(form: SendFormat | ReceiveFormat, bits: dict[str, int]) -> int:
    return sum(bit for name, bit in bits.items() if getattr(form, name))


class FormatParameter(NamedTuple):
    value: int
    microseconds: bool = False


def parse_format_parameter(parameter: Variant) -> FormatParameter | None:
    """Decode a format number, or an array of a format number and a time unit (1 for µs). Return None for any
    other parameter.
    """
    value = parameter.value
    items = value if isinstance(value, tuple) else (value,)
    plain = [item.value if isinstance(item, Variant) else item for item in items[:2]]
    whole = [item for item in plain if isinstance(item, int) and not isinstance(item, bool)]
    if not whole or len(whole) != len(plain):
        return None
    return FormatParameter(whole[0], len(whole) > 1 and whole[1] == 1)
