"""Poses as clients write them: text, arrays, or arrays of both.

`@E J(0, 0, 90, 0)`, `@P P1`, a bare array of numbers, or a VARIANT array of numbers, type, pass and extra
axes (ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from bcapscope.protocol.enumerations import POSE_TYPES
from bcapscope.protocol.hresult import E_INVALIDARG
from bcapscope.protocol.poses import guess_type
from bcapscope.protocol.slavemode import PoseType
from bcapscope.protocol.variant import ARRAY, VT, Variant
from bcapscope.simulator import values
from bcapscope.simulator.kinematics import Joints, joints_of
from bcapscope.simulator.outcome import RefusedError

END_OF_ENCODERS = -2
"""@E: the motion is done when the encoders have arrived."""

PASSING = -1
"""@P: the next motion may begin before this one ends."""

LONGEST = 512

_TEXT = re.compile(
    r"\s*(?:@(?P<pass>[PE]|[0-9]{1,4})\s*)?(?P<type>[PJT])\s*(?:(?P<index>[0-9]{1,5})|\((?P<list>[^()]*)\))\s*",
    re.IGNORECASE,
)

ReadVariable = Callable[[str, int], Variant]


class Target(NamedTuple):
    """Where a motion goes.

    Attributes:
        joints: eight, degrees.
        passing: -1 for @P, -2 for @E, else the distance of @n; 0 unless given.
    """

    joints: Joints
    passing: int


def parse_target(pose: Variant, read: ReadVariable) -> Target:
    """Read a pose in any notation; `read` gives the values of P, J and T variables.

    Raises:
        RefusedError: it makes no sense, or the arm cannot reach it.
    """
    if isinstance(pose.value, str):
        return _from_text(pose.value, read)
    items = values.items_of(pose)
    if pose.vt == ARRAY | VT.VARIANT and items and (items[0].vt & ARRAY or items[0].vt == VT.BSTR):
        return _from_parts(items, read)
    return Target(_joints(None, values.numbers_of(pose)), 0)


def _from_text(text: str, read: ReadVariable) -> Target:
    match = _TEXT.fullmatch(text) if len(text) <= LONGEST else None
    if match is None:
        raise RefusedError(E_INVALIDARG)
    type_ = PoseType(match["type"].upper())
    if match["index"]:
        numbers = values.numbers_of(read(type_, int(match["index"])))
    else:
        numbers = tuple(map(_number, match["list"].split(",")))
    return Target(_joints(type_, numbers), _pass_of_text(match["pass"]))


def _from_parts(items: tuple[Variant, ...], read: ReadVariable) -> Target:
    if items[0].vt == VT.BSTR:
        return parse_target(items[0], read)
    type_ = _type(items[1]) if len(items) > 1 else None
    passing = _pass(items[2]) if len(items) > 2 else 0
    return Target(_joints(type_, values.numbers_of(items[0])), passing)


def _joints(type_: PoseType | None, numbers: tuple[float, ...]) -> Joints:
    type_ = type_ or guess_type(numbers)
    if type_ is None:
        raise RefusedError(E_INVALIDARG)
    return joints_of(type_, numbers)


def _type(part: Variant) -> PoseType:
    letter = part.value if isinstance(part.value, str) else POSE_TYPES.get(values.integer_of(part), "")
    try:
        return PoseType(letter.strip().upper())
    except ValueError:
        raise RefusedError(E_INVALIDARG) from None


def _pass(part: Variant) -> int:
    if isinstance(part.value, str):
        match = re.fullmatch(r"\s*@([PE]|[0-9]{1,4})\s*|\s*", part.value[:LONGEST], re.IGNORECASE)
        if match is None:
            raise RefusedError(E_INVALIDARG)
        return _pass_of_text(match[1])
    return values.integer_of(part)


def _pass_of_text(text: str | None) -> int:
    if text is None:
        return 0
    return {"P": PASSING, "E": END_OF_ENCODERS}.get(text.upper()) or int(text)


def _number(text: str) -> float:
    return float(values.number_of(values.bstr(text)))
