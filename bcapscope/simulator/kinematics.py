"""Kinematics of a simple arm: joints to position, and position to joints.

No public source gives the link lengths of the real arms, so the simulated arm is not a model of a DENSO
robot. J1 turns about the vertical. J2 and J3 move two links of equal length in a vertical plane. The wrist
has no length: the angles J4, J5 and J6 equal Rx, Ry and Rz. The conversion is exact in both directions. The
rotation of a pose is Rz·Ry·Rx. A pose holds X, Y, Z in mm, then Rx, Ry, Rz in degrees.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import acos, asin, atan2, cos, degrees, hypot, radians, sin
from typing import NamedTuple, TypeAlias

from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError

Joints: TypeAlias = tuple[float, ...]
"""Eight angles in degrees. The simulated arm has only six joints, so the last two angles are 0."""

AXIS_COUNT = 6
SHOULDER_HEIGHT = 400.0
LINK_LENGTH = 350.0
"""Lengths in mm; the arm reaches 700 mm from its shoulder."""

HOME: Joints = (0.0, 0.0, 90.0, 0.0, 90.0, 0.0, 0.0, 0.0)

FIG = 1.0
"""Value of Fig in every computed position. The simulator ignores the Fig that a client sends."""


class AxisLimit(NamedTuple):
    """Limits of one joint in degrees, degrees per second, and degrees per second squared."""

    low: float
    high: float
    speed: float
    acceleration: float


AXIS_LIMITS: tuple[AxisLimit, ...] = (
    AxisLimit(-170.0, 170.0, 300.0, 6000.0),
    AxisLimit(-135.0, 135.0, 250.0, 5000.0),
    AxisLimit(-10.0, 180.0, 300.0, 6000.0),
    AxisLimit(-270.0, 270.0, 400.0, 8000.0),
    AxisLimit(-120.0, 120.0, 400.0, 8000.0),
    AxisLimit(-360.0, 360.0, 700.0, 14000.0),
)
"""Assumed limits, wide enough for the set points in DENSO Wave 2009, How to use the Slave mode."""


_P, _J, _T = PoseType.P, PoseType.J, PoseType.T
_NOT_THERE = (0.0, 0.0)


def pad_joints(values: tuple[float, ...]) -> Joints:
    return values[:AXIS_COUNT] + _NOT_THERE


def axis_beyond_limit(joints: Joints, limits: tuple[AxisLimit, ...] = AXIS_LIMITS) -> int | None:
    """Return the number (1..6) of the first axis outside its limits, or None."""
    # Unrolled for speed: every slvMove calls this function, and a loop takes three times as long.
    j1, j2, j3, j4, j5, j6, _, _ = joints
    l1, l2, l3, l4, l5, l6 = limits
    if (
        l1[0] <= j1 <= l1[1]
        and l2[0] <= j2 <= l2[1]
        and l3[0] <= j3 <= l3[1]
        and l4[0] <= j4 <= l4[1]
        and l5[0] <= j5 <= l5[1]
        and l6[0] <= j6 <= l6[1]
    ):
        return None
    inside = (limit.low <= joint <= limit.high for joint, limit in zip(joints, limits, strict=False))
    return list(inside).index(False) + 1


def position(joints: Joints) -> tuple[float, ...]:
    """Compute X, Y, Z (mm), Rx, Ry, Rz (degrees) and Fig from joints."""
    first, second, elbow = (radians(value) for value in joints[:3])
    radius = LINK_LENGTH * (sin(second) + sin(second + elbow))
    height = SHOULDER_HEIGHT + LINK_LENGTH * (cos(second) + cos(second + elbow))
    return (radius * cos(first), radius * sin(first), height, *joints[3:6], FIG)


def joints_of_position(values: tuple[float, ...]) -> Joints:
    """Compute the joints that reach X, Y, Z, Rx, Ry, Rz, or refuse a position that is out of reach."""
    x, y, z, *wrist = values[:6]
    radius, height = hypot(x, y), z - SHOULDER_HEIGHT
    reach = hypot(radius, height) / (2 * LINK_LENGTH)
    if reach > 1:
        raise RefusedError(RefusalCode.POSITION_LIMIT + 2)
    elbow = 2 * acos(reach)
    second = atan2(radius, height) - elbow / 2
    return pad_joints((degrees(atan2(y, x)), degrees(second), degrees(elbow), *wrist))


def trans(joints: Joints) -> tuple[float, ...]:
    """Compute the T-type pose for `joints`: X, Y, Z, the rotation's second and third column, and Fig."""
    _, orientation, approach = _transposed(rotation(joints))
    return (*position(joints)[:3], *orientation, *approach, FIG)


def joints_of_trans(values: tuple[float, ...]) -> Joints:
    ox, oy, oz, ax, ay, az = values[3:9]
    normal = oy * az - oz * ay, oz * ax - ox * az, ox * ay - oy * ax
    turn = _transposed((normal, (ox, oy, oz), (ax, ay, az)))
    return joints_of_position((*values[:3], *_angles(turn)))


def joints_of(pose_type: PoseType, values: tuple[float, ...]) -> Joints:
    """Compute the joints of any pose of finite numbers; refuse a pose that is too short or out of reach."""
    if len(values) < (9 if pose_type is _T else AXIS_COUNT):
        raise RefusedError(E_INVALIDARG)
    if pose_type is _J:
        return values[:AXIS_COUNT] + _NOT_THERE
    return joints_of_position(values) if pose_type is _P else joints_of_trans(values)


def pose_of(pose_type: PoseType, joints: Joints) -> tuple[float, ...]:
    if pose_type is _J:
        return joints
    return position(joints) if pose_type is _P else trans(joints)


FEWEST_NUMBERS: Mapping[PoseType, int] = {_P: 6, _J: 6, _T: 9}

POSE_LENGTHS: Mapping[PoseType, range] = {
    pose_type: range(FEWEST_NUMBERS[pose_type], len(axes) + 2) for pose_type, axes in AXES.items()
}
"""How many numbers a set point may have: at most one more than the pose type has axes."""


Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]
"""Three rows."""

PoseNumbers: TypeAlias = tuple[float, ...]
"""The six numbers of a position and orientation; further numbers are ignored."""


def moved_in_base(pose: PoseNumbers, deviation: PoseNumbers) -> PoseNumbers:
    """Move a pose along the axes of the base, and turn the pose about these axes."""
    place = tuple(a + b for a, b in zip(pose[:3], deviation[:3], strict=True))
    return place + _combined_angles(pose, deviation, rotation(deviation), rotation(pose))


def moved_in_tool(pose: PoseNumbers, deviation: PoseNumbers) -> PoseNumbers:
    """Move a pose along its own axes, and turn the pose about these axes."""
    turn = rotation(pose)
    place = tuple(a + b for a, b in zip(pose[:3], _apply(turn, deviation[:3]), strict=True))
    return place + _combined_angles(pose, deviation, turn, rotation(deviation))


def relative_to(frame: PoseNumbers, pose: PoseNumbers) -> PoseNumbers:
    """Convert a pose in base coordinates to coordinates of `frame`."""
    back = _transposed(rotation(frame))
    place = _apply(back, tuple(a - b for a, b in zip(pose[:3], frame[:3], strict=True)))
    return place + _combined_angles(pose, frame, back, rotation(pose))


def rotation(pose: PoseNumbers) -> Matrix:
    a, b, c = (radians(angle) for angle in pose[3:6])
    return (
        (
            cos(c) * cos(b),
            cos(c) * sin(b) * sin(a) - sin(c) * cos(a),
            cos(c) * sin(b) * cos(a) + sin(c) * sin(a),
        ),
        (
            sin(c) * cos(b),
            sin(c) * sin(b) * sin(a) + cos(c) * cos(a),
            sin(c) * sin(b) * cos(a) - cos(c) * sin(a),
        ),
        (-sin(b), cos(b) * sin(a), cos(b) * cos(a)),
    )


def _combined_angles(pose: PoseNumbers, other: PoseNumbers, first: Matrix, second: Matrix) -> PoseNumbers:
    """Return the angles Rx, Ry, Rz of the rotation `first`·`second`.

    If `other` has no rotation, return the angles of `pose` unchanged. Computed angles could differ by a full
    turn, and set points would then jump.
    """
    if not any(other[3:6]):
        return pose[3:6]
    return _angles(_transposed(tuple(_apply(first, column) for column in _transposed(second))))


def _angles(turn: Matrix) -> Vector:
    pitch = asin(max(-1.0, min(1.0, -turn[2][0])))
    return degrees(atan2(turn[2][1], turn[2][2])), degrees(pitch), degrees(atan2(turn[1][0], turn[0][0]))


def _apply(turn: Matrix, vector: PoseNumbers) -> Vector:
    x, y, z = (sum(a * b for a, b in zip(row, vector, strict=True)) for row in turn)
    return x, y, z


def _transposed(rows: Iterable[Vector]) -> Matrix:
    x, y, z = zip(*rows, strict=True)
    return x, y, z
