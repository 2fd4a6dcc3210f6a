"""Labels for the parts of slvMove's parameter and result: joints, coordinates, I/O words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.messages import Message
from bcapscope.messages.places import Listing
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.slave_mode.poses import Pose
from bcapscope.protocol.slave_mode.slvmove_values import Feedback, SetPoint, parse_feedback, parse_set_point


class ValueLabel(NamedTuple):
    """Name and meaning of a value in an argument or a result.

    Attributes:
        name: Name of the value, such as `J1` or `hand I/O`.
        unit: Unit of the value: `mm`, `deg`, or empty.
        text: Explanation of the value, one clause; may be empty.
        elements: Labels of the value's elements in order, as far as known.
    """

    name: str = ""
    unit: str = ""
    text: str | Message = ""
    elements: tuple[ValueLabel, ...] = ()


NO_LABEL = ValueLabel()


def slvmove_label(variant: Variant, is_request: bool) -> ValueLabel:
    """Label the parts of slvMove's parameter or result, as far as the value alone shows them.

    The label of the whole value has an empty name. Formats and slave mode are set by earlier calls, which are
    unknown here. Therefore the labels are guesses from the number and types of the elements. The label's
    `text` says so.
    """
    found = parse_set_point(variant) if is_request else parse_feedback(variant)
    named = list(_set_point_labels(found) if isinstance(found, SetPoint) else _feedback_labels(found))
    if len(named) == 1 and named[0].elements and not _begins_with_array(variant):
        return named[0]._replace(name="")
    if found.problems or not isinstance(variant.value, tuple) or len(named) != len(variant.value):
        return NO_LABEL
    return ValueLabel(text=Message("field.parts-guessed") if found.guessed else "", elements=tuple(named))


def _begins_with_array(variant: Variant) -> bool:
    first = variant.value[0] if isinstance(variant.value, tuple) and variant.value else None
    return isinstance(first, Variant) and isinstance(first.value, tuple)


def _set_point_labels(found: SetPoint) -> Iterator[ValueLabel]:
    if found.pose is not None:
        yield _poses_label((found.pose,))
    if found.mini_io is not None:
        yield ValueLabel("mini I/O")
    if found.user_write is not None:
        yield from _user_io_labels("user I/O to write", ("offset", "bits", "data"))
    if found.user_read is not None:
        yield from _user_io_labels("user I/O to read", ("offset", "bits"))
    if found.hand_io is not None:
        yield ValueLabel("hand I/O")


def _user_io_labels(name: str, words: tuple[str, ...]) -> Iterator[ValueLabel]:
    return (ValueLabel(f"{name}, {word}") for word in words)


def _feedback_labels(found: Feedback) -> Iterator[ValueLabel]:
    if found.timestamp is not None:
        yield ValueLabel("time stamp")
    if found.poses:
        yield _poses_label(found.poses)
    if found.mini_io is not None:
        yield ValueLabel("mini I/O")
    if found.user_io is not None:
        yield ValueLabel("user I/O")
    if found.hand_io is not None:
        yield ValueLabel("hand I/O")
    if found.current:
        yield ValueLabel(
            "motor current", elements=tuple(ValueLabel(f"J{axis + 1}") for axis in range(len(found.current)))
        )


def _poses_label(poses: tuple[Pose, ...]) -> ValueLabel:
    types = Listing(tuple(str(pose.type) for pose in poses if pose.type is not None))
    case = "field.pose.guessed" if any(pose.guessed for pose in poses) else "field.pose"
    text = Message(case, types=types) if types.items else ""
    return ValueLabel(
        "pose", text=text, elements=tuple(part for pose in poses for part in _axis_labels(pose))
    )


def _axis_labels(pose: Pose) -> Iterator[ValueLabel]:
    if pose.type is not None:
        yield from (ValueLabel(axis.name, axis.unit) for axis in pose.axes)
        mark = ValueLabel("axes", text=Message("field.axis-bits"))
        yield from (mark if pose.used_axes is not None else NO_LABEL for _ in pose.extra)
