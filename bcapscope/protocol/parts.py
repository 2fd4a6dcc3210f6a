"""Names for the parts of what slvMove carries: joints, coordinates, I/O words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from bcapscope.protocol.poses import Pose
from bcapscope.protocol.setpoints import Feedback, SetPoint, split_feedback, split_set_point
from bcapscope.protocol.variant import Variant


class Part(NamedTuple):
    """What a value is called.

    Attributes:
        name: such as `J1` or `hand I/O`.
        unit: `mm`, `deg`, or empty.
        text: what else there is to say, one clause; else empty.
        parts: names of its elements in order, as far as they are known.
    """

    name: str = ""
    unit: str = ""
    text: str = ""
    parts: tuple[Part, ...] = ()


UNNAMED = Part()


def slv_move_part(variant: Variant, is_request: bool) -> Part:
    """Name the parts of slvMove's parameter or result, as far as the value alone tells.

    The name of the whole is left empty. Formats and mode are settled by earlier calls, so nearly all of it
    is guessed from the count and the types of the elements, and its `text` says so.

    Args:
        variant: vntParam of the request, or the reply's value.
        is_request: which of the two.
    """
    found = split_set_point(variant) if is_request else split_feedback(variant)
    named = list(_set_point(found) if isinstance(found, SetPoint) else _feedback(found))
    if len(named) == 1 and named[0].parts and not _is_list(variant):
        return named[0]._replace(name="")
    if found.problems or not isinstance(variant.value, tuple) or len(named) != len(variant.value):
        return UNNAMED
    return Part(text="parts guessed" if found.guessed else "", parts=tuple(named))


def _is_list(variant: Variant) -> bool:
    first = variant.value[0] if isinstance(variant.value, tuple) and variant.value else None
    return isinstance(first, Variant) and isinstance(first.value, tuple)


def _set_point(found: SetPoint) -> Iterator[Part]:
    if found.pose is not None:
        yield _poses((found.pose,))
    if found.mini_io is not None:
        yield Part("mini I/O")
    if found.user_write is not None:
        yield from _run("user I/O to write", ("offset", "bits", "data"))
    if found.user_read is not None:
        yield from _run("user I/O to read", ("offset", "bits"))
    if found.hand_io is not None:
        yield Part("hand I/O")


def _run(name: str, words: tuple[str, ...]) -> Iterator[Part]:
    return (Part(f"{name}, {word}") for word in words)


def _feedback(found: Feedback) -> Iterator[Part]:
    if found.timestamp is not None:
        yield Part("time stamp")
    if found.poses:
        yield _poses(found.poses)
    if found.mini_io is not None:
        yield Part("mini I/O")
    if found.user_io is not None:
        yield Part("user I/O")
    if found.hand_io is not None:
        yield Part("hand I/O")
    if found.current:
        yield Part("motor current", parts=tuple(Part(f"J{axis + 1}") for axis in range(len(found.current))))


def _poses(poses: tuple[Pose, ...]) -> Part:
    types = " and ".join(str(pose.type) for pose in poses if pose.type is not None)
    guessed = ", guessed" if any(pose.guessed for pose in poses) else ""
    text = f"{types} pose{guessed}" if types else ""
    return Part("pose", text=text, parts=tuple(part for pose in poses for part in _axes(pose)))


def _axes(pose: Pose) -> Iterator[Part]:
    if pose.type is not None:
        yield from (Part(axis.name, axis.unit) for axis in pose.axes)
        mark = Part("axes", text="bit for each axis that the ROS driver uses")
        yield from (mark if pose.used_axes is not None else UNNAMED for _ in pose.extra)
