"""Names and meanings of arguments and results, including the elements of slvMove's set points and results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from bcapscope.messages import Message
from bcapscope.messages.places import Listing
from bcapscope.protocol.codec.variant import ARRAY, Variant
from bcapscope.protocol.slave_mode.poses import AXES, Pose
from bcapscope.protocol.slave_mode.slvmove_values import parse_feedback, parse_set_point
from bcapscope.protocol.tables import enumerations
from bcapscope.protocol.tables.function_table import ID, ObjectClass
from bcapscope.protocol.tables.table_text import table_message


class ValueLabel(NamedTuple):
    """Label of a value: name, unit (such as `mm`) and meaning, each "" if unknown, and labels of elements."""

    name: str = ""
    unit: str = ""
    text: str | Message = ""
    elements: tuple[ValueLabel, ...] = ()


NO_LABEL = ValueLabel()


def slvmove_label(variant: Variant, is_request: bool) -> ValueLabel:
    """Return a label with the names of the elements in slvMove's parameter or result. The names depend on the
    formats and on the slave mode, which earlier calls selected. This function does not know these calls, so
    it guesses the names from the number and types of the elements. The label's `text` says whether the names
    are guessed.
    """
    found = parse_set_point(variant) if is_request else parse_feedback(variant)
    named = list(_part_labels(found._asdict()))
    if len(named) == 1 and named[0].elements and not _begins_with_array(variant):
        return named[0]._replace(name="")
    if found.problems or not isinstance(variant.value, tuple) or len(named) != len(variant.value):
        return NO_LABEL
    return ValueLabel(text=Message("field.parts-guessed") if found.guessed else "", elements=tuple(named))


def _begins_with_array(variant: Variant) -> bool:
    value = variant.value
    return isinstance(value, tuple) and isinstance(value[0], Variant) and isinstance(value[0].value, tuple)


_PART_LABELS = {
    "timestamp": (ValueLabel("time stamp"),),
    "mini_io": (ValueLabel("mini I/O"),),
    "user_write": tuple(ValueLabel(f"user I/O to write, {word}") for word in ("offset", "bits", "data")),
    "user_read": tuple(ValueLabel(f"user I/O to read, {word}") for word in ("offset", "bits")),
    "user_io": (ValueLabel("user I/O"),),
    "hand_io": (ValueLabel("hand I/O"),),
}
"""The labels of each field of `SetPoint` and `Feedback`, in the order of the elements in slvMove's array."""


def _part_labels(fields: Mapping[str, Any]) -> Iterator[ValueLabel]:
    for name, value in fields.items():
        if isinstance(value, Pose):
            yield _poses_label((value,))
        elif name == "poses" and value:
            yield _poses_label(value)
        elif name == "current" and value:
            axes = tuple(ValueLabel(f"J{axis + 1}") for axis in range(len(value)))
            yield ValueLabel("motor current", elements=axes)
        elif value is not None:
            yield from _PART_LABELS.get(name, ())


def _poses_label(poses: tuple[Pose, ...]) -> ValueLabel:
    types = Listing(tuple(str(pose.type) for pose in poses if pose.type is not None))
    case = "field.pose.guessed" if any(pose.guessed for pose in poses) else "field.pose"
    text = Message(case, types=types) if types.items else ""
    axes = tuple(label for pose in poses for label in _axis_labels(pose))
    return ValueLabel("pose", text=text, elements=axes)


def _axis_labels(pose: Pose) -> Iterator[ValueLabel]:
    if pose.type is not None:
        yield from (ValueLabel(axis.name, axis.unit) for axis in pose.axes)
        mark = ValueLabel("axes", text=Message("field.axis-bits"))
        yield from (mark if pose.used_axes is not None else NO_LABEL for _ in pose.extra)


_HANDLE_LABELS = {
    f"h{kind}": ValueLabel(text=Message("field.handle", object=kind.value)) for kind in ObjectClass
}
_ARGUMENT_MEANINGS: dict[tuple[int | None, str], Mapping[int, str]] = {
    (ID["Robot_Move"], "lComp"): enumerations.INTERPOLATIONS,
    (ID["Robot_Speed"], "lAxis"): enumerations.SPEED_AXES,
    (ID["Robot_Accelerate"], "lAxis"): enumerations.SPEED_AXES,
    (ID["Task_Start"], "lMode"): enumerations.TASK_START_MODES,
    (ID["Task_Stop"], "lMode"): enumerations.TASK_STOP_MODES,
}
_PARAMETER_MEANINGS: dict[tuple[int | None, str], Mapping[int, str]] = {
    (ID["Controller_Execute"], "putautomode"): enumerations.AUTO_MODES
}
_AXES = {str(type_): axes for type_, axes in AXES.items()}


def argument_label(function_id: int | None, command: str | None, name: str, variant: Variant) -> ValueLabel:
    """Return the label of a request's argument. `name` is the argument's name, such as `lComp`."""
    value = variant.value
    if type(value) is int:
        named = _ARGUMENT_MEANINGS.get((function_id, name)) or {}
        if name == "vntParam":
            named = _PARAMETER_MEANINGS.get((function_id, (command or "").casefold())) or {}
        return _HANDLE_LABELS.get(name) or ValueLabel(text=_meaning(named.get(value)))
    if isinstance(value, str):
        return ValueLabel(text=_string_meaning(function_id, name, value))
    if name == "vntPose":
        return _pose_label(variant)
    if name == "vntParam" and function_id == ID["Robot_Execute"] and (command or "").casefold() == "approach":
        return _approach_label(variant)
    return NO_LABEL


def result_label(function_id: int | None, command: str | None, name: str, variant: Variant) -> ValueLabel:
    """Return the label of the value in a reply. `function_id` and `command` are those of the request."""
    if type(variant.value) is not int:
        return NO_LABEL
    found = enumerations.result_meanings(function_id, command or "", variant.value)
    text = _all_of("field.meanings", [table_message(each) for each in found])
    return _HANDLE_LABELS.get(name) or ValueLabel(text=text)


def _meaning(text: str | None) -> str | Message:
    return table_message(text) if text else ""


def _string_meaning(function_id: int | None, name: str, value: str) -> str | Message:
    if name == "bstrProvider":
        return _meaning(enumerations.provider_meaning(value))
    if name == "bstrOption":
        found = enumerations.option_meanings(value, is_move=function_id == ID["Robot_Move"])
        if len(found) == 1:
            return table_message(next(iter(found.values())))
        meanings = {key: table_message(text) for key, text in found.items()}
        options = [Message("field.option", key=key, meaning=text) for key, text in meanings.items()]
        return _all_of("field.options", options)
    return ""


def _all_of(id: str, meanings: Sequence[Message]) -> str | Message:
    """Join `meanings` into one message. The message `id` must have the placeholders `first` and `rest`."""
    if not meanings:
        return ""
    *others, found = meanings
    for each in reversed(others):
        found = Message(id, first=each, rest=found)
    return found


def _elements(variant: Variant) -> tuple[Variant, ...]:
    """Return the elements of a VARIANT array; () if the value is not a VARIANT array."""
    items = variant.value if isinstance(variant.value, tuple) else ()
    return tuple(item for item in items if isinstance(item, Variant))


def _pose_label(variant: Variant) -> ValueLabel:
    """Name the elements of a pose that is a VARIANT array: numbers, pose type, pass motion and extra axes."""
    items = _elements(variant)
    if not items or not items[0].vt & ARRAY:
        return NO_LABEL
    type_, motion = _integer_at(items, 1), _integer_at(items, 2)
    letter = "" if type_ is None else enumerations.POSE_TYPES.get(type_, "")
    pass_motion = "" if motion is None else enumerations.pass_motion_text(motion)
    axes = _AXES.get(letter or _text_at(items, 1), ())
    return ValueLabel(
        elements=(
            ValueLabel("numbers", elements=tuple(ValueLabel(axis.name, axis.unit) for axis in axes)),
            ValueLabel("pose type", text=letter),
            ValueLabel("pass", text=pass_motion),
            ValueLabel("extra axes"),
        )
    )


def _integer_at(items: tuple[Variant, ...], index: int) -> int | None:
    value = items[index].value if index < len(items) else None
    return value if type(value) is int else None


def _text_at(items: tuple[Variant, ...], index: int) -> str:
    value = items[index].value if index < len(items) else None
    return value.strip().upper() if isinstance(value, str) else ""


def _approach_label(variant: Variant) -> ValueLabel:
    items = _elements(variant)
    if len(items) < 3:
        return NO_LABEL
    number = _integer_at(items, 0)
    meaning = None if number is None else enumerations.INTERPOLATIONS.get(number)
    interpolation = ValueLabel("interpolation", text=_meaning(meaning))
    pose = _pose_label(items[1])._replace(name="pose")
    return ValueLabel(elements=(interpolation, pose, ValueLabel("distance", "mm")))
