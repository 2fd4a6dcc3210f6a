"""Reads poses in each notation that clients use: text, an array of numbers, or an array of VARIANTs.

Examples of text are `@E J(0, 0, 90, 0)` and `@P P1`. An array of VARIANTs contains the coordinates, the pose
type, the pass motion and the extra axes (ShoheiKobata/orin_bcap_python_samples, DENSORobot/denso_robot_ros2).
Instead of coordinates, clients may send the number of a variable, as in `[1, "P", "@0"]`. In some of
ShoheiKobata's samples, the pass motion, such as "@0", comes before the pose type.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import guess_pose_type
from bcapscope.protocol.tables.enumerations import POSE_TYPES
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.simulator import argument_values
from bcapscope.simulator.call_outcome import RefusedError
from bcapscope.simulator.kinematics import FEWEST_NUMBERS, Joints, joints_of

END_OF_ENCODERS = -2
"""Pass motion @E: the motion ends when the encoders reach the target."""

PASSING = -1
"""Pass motion @P: the next motion may begin before the present motion ends."""

LONGEST_POSE_TEXT = 512

_TEXT = re.compile(
    r"\s*(?:@(?P<pass>[PE]|[0-9]{1,4})\s*)?(?P<type>[PJT])\s*(?:(?P<index>[0-9]{1,5})|\((?P<list>[^()]*)\))\s*",
    re.IGNORECASE,
)

ReadVariable = Callable[[str, int], Variant]


class MotionTarget(NamedTuple):
    """`joints` are eight joints in degrees. `passing` is the pass motion: -1 for @P, -2 for @E, n for @n."""

    joints: Joints
    passing: int


class WrittenPose(NamedTuple):
    """A pose as a client wrote it, with at least six numbers; `passing` is as in `MotionTarget`."""

    type: PoseType
    values: tuple[float, ...]
    passing: int


def parse_target(pose: Variant, read: ReadVariable) -> MotionTarget:
    written = parse_pose(pose, read)
    return MotionTarget(joints_of(written.type, written.values), written.passing)


def parse_pose(pose: Variant, read: ReadVariable) -> WrittenPose:
    """Read a pose in any notation, or refuse the call. `read` returns the value of a P, J or T variable."""
    if isinstance(pose.value, str):
        return _from_text(pose.value, read)
    items = argument_values.items_of(pose)
    # An array of two to four items is too short for a pose of numbers. Its first item is an array of
    # coordinates or the number of a variable. The other items are the pose type, pass motion and extra axes.
    if items and (not _is_number(items[0]) or 1 < len(items) <= 4):
        return _from_parts(items, read)
    return _make_pose(None, argument_values.numbers_of(pose), 0)


def parse_pass(part: Variant) -> int:
    """Read a pass motion: text such as `@P`, `@E` or `@10`, or a number. Return 0 for an empty text."""
    if not isinstance(part.value, str):
        return argument_values.integer_of(part)
    match = re.fullmatch(r"\s*@([PE]|[0-9]{1,4})\s*|\s*", part.value[:LONGEST_POSE_TEXT], re.IGNORECASE)
    if match is None:
        raise RefusedError(E_INVALIDARG)
    return parse_pass_text(match[1])


def parse_pass_text(text: str | None) -> int:
    if text is None:
        return 0
    return {"P": PASSING, "E": END_OF_ENCODERS}.get(text.upper()) or int(text)


def _from_text(text: str, read: ReadVariable) -> WrittenPose:
    match = _TEXT.fullmatch(text) if len(text) <= LONGEST_POSE_TEXT else None
    if match is None:
        raise RefusedError(E_INVALIDARG)
    type_ = PoseType(match["type"].upper())
    if match["index"]:
        numbers = argument_values.numbers_of(read(type_, int(match["index"])))
    else:
        texts = map(argument_values.bstr, match["list"].split(","))
        numbers = tuple(float(argument_values.number_of(text)) for text in texts)
    return _make_pose(type_, numbers, parse_pass_text(match["pass"]))


def _from_parts(items: tuple[Variant, ...], read: ReadVariable) -> WrittenPose:
    type_, passing = _type_and_pass(items[1:3])
    if items[0].vt == VT.BSTR:
        written = parse_pose(items[0], read)
        return written._replace(passing=passing or written.passing)
    if not _is_number(items[0]):
        return _make_pose(type_, argument_values.numbers_of(items[0]), passing)
    if type_ is None:
        raise RefusedError(E_INVALIDARG)
    return _make_pose(
        type_, argument_values.numbers_of(read(type_, argument_values.integer_of(items[0]))), passing
    )


def _type_and_pass(parts: tuple[Variant, ...]) -> tuple[PoseType | None, int]:
    """Read the pose type and the pass motion, which may come in either order."""
    if parts and isinstance(parts[0].value, str) and "@" in parts[0].value:
        parts = (parts[1] if len(parts) > 1 else argument_values.bstr(""), parts[0])
    type_ = _type(parts[0]) if parts else None
    return type_, parse_pass(parts[1]) if len(parts) > 1 else 0


def _is_number(item: Variant) -> bool:
    return isinstance(item.value, int | float)


def _make_pose(type_: PoseType | None, numbers: tuple[float, ...], passing: int) -> WrittenPose:
    type_ = type_ or guess_pose_type(numbers)
    if type_ is None or len(numbers) < FEWEST_NUMBERS[type_]:
        raise RefusedError(E_INVALIDARG)
    return WrittenPose(type_, numbers, passing)


def _type(part: Variant) -> PoseType | None:
    """Read a pose type; return None for an empty text, and for -1, which means no type."""
    value = part.value
    letter = (
        value.strip() if isinstance(value, str) else POSE_TYPES.get(argument_values.integer_of(part), "?")
    )
    if letter in ("", "none"):
        return None
    try:
        return PoseType(letter.upper())
    except ValueError:
        raise RefusedError(E_INVALIDARG) from None
