"""Conversion of poses between coordinate systems: X, Y, Z in mm, Rx, Ry, Rz in degrees, and other numbers.

The rotation of a pose is Rz·Ry·Rx, as in `kinematics.trans`.
"""

from __future__ import annotations

from math import asin, atan2, cos, degrees, radians, sin
from typing import TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]
"""Three rows."""

PoseNumbers: TypeAlias = tuple[float, ...]
"""The six numbers of a position and orientation; further numbers are ignored."""


def moved_in_base(pose: PoseNumbers, deviation: PoseNumbers) -> PoseNumbers:
    """Move and turn a pose along and about the axes of the base; return six numbers."""
    place = _add(_position(pose), _position(deviation))
    return place + _combined_angles(pose, deviation, rotation(deviation), rotation(pose))


def moved_in_tool(pose: PoseNumbers, deviation: PoseNumbers) -> PoseNumbers:
    """Move and turn a pose along and about its own axes; return six numbers."""
    turn = rotation(pose)
    place = _add(_position(pose), _apply(turn, _position(deviation)))
    return place + _combined_angles(pose, deviation, turn, rotation(deviation))


def relative_to(frame: PoseNumbers, pose: PoseNumbers) -> PoseNumbers:
    """Convert a pose in base coordinates to coordinates of `frame`; return six numbers."""
    back = _transposed(rotation(frame))
    ahead = _position(pose)
    away = tuple(a - b for a, b in zip(ahead, _position(frame), strict=True))
    place = _apply(back, (away[0], away[1], away[2]))
    return place + _combined_angles(pose, frame, back, rotation(pose))


def rotation(pose: PoseNumbers) -> Matrix:
    about_x, about_y, about_z = (radians(angle) for angle in pose[3:6])
    c, s = cos(about_x), sin(about_x)
    turn_x: Matrix = ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))
    c, s = cos(about_y), sin(about_y)
    turn_y: Matrix = ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))
    c, s = cos(about_z), sin(about_z)
    turn_z: Matrix = ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
    return _product(turn_z, _product(turn_y, turn_x))


def _combined_angles(pose: PoseNumbers, other: PoseNumbers, first: Matrix, second: Matrix) -> PoseNumbers:
    """Return the angles of first·second.

    If the second rotation is zero, the angles of `pose` stay exactly the same, so that set points do not jump
    by a full turn.
    """
    return pose[3:6] if not any(other[3:6]) else _angles(_product(first, second))


def _angles(turn: Matrix) -> Vector:
    pitch = asin(max(-1.0, min(1.0, -turn[2][0])))
    return degrees(atan2(turn[2][1], turn[2][2])), degrees(pitch), degrees(atan2(turn[1][0], turn[0][0]))


def _position(pose: PoseNumbers) -> Vector:
    return pose[0], pose[1], pose[2]


def _add(one: Vector, other: Vector) -> Vector:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


def _apply(turn: Matrix, vector: Vector) -> Vector:
    x, y, z = (sum(a * b for a, b in zip(line, vector, strict=True)) for line in turn)
    return x, y, z


def _product(first: Matrix, second: Matrix) -> Matrix:
    columns = _transposed(second)
    x, y, z = (_apply(columns, line) for line in first)
    return x, y, z


def _transposed(turn: Matrix) -> Matrix:
    x, y, z = zip(*turn, strict=True)
    return x, y, z
