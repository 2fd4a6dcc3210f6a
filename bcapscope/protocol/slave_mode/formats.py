"""Formats of slvMove: the bits of slvSendFormat and slvRecvFormat.

Source: DENSORobot/denso_robot_ros2 denso_robot_core/src/denso_robot.cpp and denso_robot.h.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.slave_mode.modes import PoseType

POSE_BITS, TIMESTAMP_BIT, HAND_IO_BIT, CURRENT_BIT, MINI_IO_BIT, USER_IO_BIT = (
    0x00F,
    0x010,
    0x020,
    0x040,
    0x100,
    0x200,
)

_POSES: dict[int, tuple[PoseType, ...]] = {
    0: (),
    1: (PoseType.P,),
    2: (PoseType.J,),
    3: (PoseType.T,),
    4: (PoseType.P, PoseType.J),
    5: (PoseType.T, PoseType.J),
}
_DIGIT_BY_POSES = {poses: digit for digit, poses in _POSES.items()}
_SEND_BITS = HAND_IO_BIT | MINI_IO_BIT | USER_IO_BIT
_UNDOCUMENTED_BIT = 0x400
"""Bit of the send format 0x620 that public clients use; no public source says what it means."""
_RECEIVE_BITS = POSE_BITS | TIMESTAMP_BIT | HAND_IO_BIT | CURRENT_BIT | MINI_IO_BIT | USER_IO_BIT


@dataclass(frozen=True, slots=True)
class SendFormat:
    """What slvMove carries besides the pose.

    Attributes:
        hand_io: a word whose bit 0 is IO48; IO64..IO71 are written.
        mini_io: a word whose bit 0 is IO0; IO24..IO31 are written, from IO16 on some controllers.
        user_io: a chosen run of I/O bits.
        other: bits without a known meaning, kept as they are.
    """

    hand_io: bool = False
    mini_io: bool = False
    user_io: bool = False
    other: int = 0

    @classmethod
    def parse(cls, value: int) -> SendFormat:
        """Read the parameter of slvSendFormat; any number gives a format."""
        return cls(
            bool(value & HAND_IO_BIT),
            bool(value & MINI_IO_BIT),
            bool(value & USER_IO_BIT),
            value & ~_SEND_BITS,
        )

    def __int__(self) -> int:
        return (
            self.other | self.hand_io * HAND_IO_BIT | self.mini_io * MINI_IO_BIT | self.user_io * USER_IO_BIT
        )

    @property
    def is_known(self) -> bool:
        """Whether clients use it: 0, 0x020, 0x100, 0x120, 0x200 or 0x220, each also with 0x400."""
        return not self.other & ~_UNDOCUMENTED_BIT and not (self.mini_io and self.user_io)


POSE_ONLY_FORMAT = SendFormat()
"""Nothing but the pose."""


@dataclass(frozen=True, slots=True)
class ReceiveFormat:
    """What slvMove returns.

    Attributes:
        poses: pose types in order; two of them come as one row of numbers.
        timestamp: time since the controller's start.
        hand_io: a word whose bit 0 is IO48.
        current: motor current of each axis.
        mini_io: a word whose bit 0 is IO0.
        user_io: the run of I/O bits that slvMove asks for.
        other: bits without a known meaning, kept as they are; so is a pose digit above 5.
        microseconds: the time stamp counts us, not ms; given beside the format, not in it.

    Raises:
        ValueError: there is no format for these poses.
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
            raise ValueError(f"no receive format returns the poses {self.poses}")

    @classmethod
    def parse(cls, value: int, microseconds: bool = False) -> ReceiveFormat:
        """Read the format number of slvRecvFormat; any number gives a format."""
        digit = value & POSE_BITS
        poses = _POSES.get(digit)
        return cls(
            poses=poses or (),
            timestamp=bool(value & TIMESTAMP_BIT),
            hand_io=bool(value & HAND_IO_BIT),
            current=bool(value & CURRENT_BIT),
            mini_io=bool(value & MINI_IO_BIT),
            user_io=bool(value & USER_IO_BIT),
            other=value & ~_RECEIVE_BITS | (digit if poses is None else 0),
            microseconds=microseconds,
        )

    def __int__(self) -> int:
        digit = _DIGIT_BY_POSES[self.poses]
        flags = self.timestamp * TIMESTAMP_BIT | self.hand_io * HAND_IO_BIT | self.current * CURRENT_BIT
        return self.other | digit | flags | self.mini_io * MINI_IO_BIT | self.user_io * USER_IO_BIT

    @property
    def bare_pose_type(self) -> PoseType | None:
        """Pose type where one pose and nothing else is asked for, which comes as it is; else None."""
        words = self.timestamp or self.hand_io or self.current or self.mini_io or self.user_io
        return self.poses[0] if len(self.poses) == 1 and not words else None

    @property
    def is_known(self) -> bool:
        """Whether the driver knows it: no other bits, and not mini and user I/O but in 0x340."""
        both = self.mini_io and self.user_io
        return not self.other and (
            not both or int(self) & ~POSE_BITS == MINI_IO_BIT | USER_IO_BIT | CURRENT_BIT
        )


class FormatParameter(NamedTuple):
    """Numbers in the parameter of slvSendFormat or slvRecvFormat.

    Attributes:
        value: the format.
        microseconds: unit of the time stamp, from the second number.
    """

    value: int
    microseconds: bool = False


def parse_format_parameter(parameter: Variant) -> FormatParameter | None:
    """Read a format out of a parameter: an integer, or an array of format and time unit; else None."""
    value = parameter.value
    items = value if isinstance(value, tuple) else (value,)
    plain = [item.value if isinstance(item, Variant) else item for item in items[:2]]
    whole = [item for item in plain if isinstance(item, int) and not isinstance(item, bool)]
    if not whole or len(whole) != len(plain):
        return None
    return FormatParameter(whole[0], len(whole) > 1 and whole[1] == 1)
