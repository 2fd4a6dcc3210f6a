"""Meanings of numbers and strings in arguments and results, where the vendor names them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bcapscope.messages import Message
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.protocol.dissection.slvmove_labels import NO_LABEL, ValueLabel
from bcapscope.protocol.slave_mode.poses import AXES
from bcapscope.protocol.tables.enumerations import (
    AUTO_MODES,
    INTERPOLATIONS,
    POSE_TYPES,
    SPEED_AXES,
    TASK_START_MODES,
    TASK_STOP_MODES,
    option_meanings,
    pass_motion_text,
    provider_meaning,
    result_meanings,
)
from bcapscope.protocol.tables.function_table import ID, ObjectClass
from bcapscope.protocol.tables.table_text import table_message

_HANDLE_LABELS = {
    f"h{kind}": ValueLabel(text=Message("field.handle", object=kind.value)) for kind in ObjectClass
}
_ARGUMENT_MEANINGS: Mapping[tuple[int, str], Mapping[int, str]] = {
    (ID["Robot_Move"], "lComp"): INTERPOLATIONS,
    (ID["Robot_Speed"], "lAxis"): SPEED_AXES,
    (ID["Robot_Accelerate"], "lAxis"): SPEED_AXES,
    (ID["Task_Start"], "lMode"): TASK_START_MODES,
    (ID["Task_Stop"], "lMode"): TASK_STOP_MODES,
}
_PARAMETER_MEANINGS: Mapping[tuple[int, str], Mapping[int, str]] = {
    (ID["Controller_Execute"], "putautomode"): AUTO_MODES
}
_AXES = {str(type_): axes for type_, axes in AXES.items()}


def argument_label(function_id: int | None, command: str | None, name: str, variant: Variant) -> ValueLabel:
    """Return the meaning of the value of argument `name`, such as `lComp`, in a request with this command."""
    value = variant.value
    if type(value) is int:
        named = _ARGUMENT_MEANINGS.get((function_id or 0, name)) or {}
        if name == "vntParam":
            named = _PARAMETER_MEANINGS.get((function_id or 0, (command or "").casefold())) or {}
        return _HANDLE_LABELS.get(name) or ValueLabel(text=_meaning(named.get(value)))
    if isinstance(value, str):
        return ValueLabel(text=_string_meaning(function_id, name, value))
    if name == "vntPose":
        return _pose_label(variant)
    if name == "vntParam" and function_id == ID["Robot_Execute"] and (command or "").casefold() == "approach":
        return _approach_label(variant)
    return NO_LABEL


def result_label(function_id: int | None, command: str | None, name: str, variant: Variant) -> ValueLabel:
    """Return the meaning of the value of result `name`, such as `hRobot`, in a reply to this command."""
    if type(variant.value) is not int:
        return NO_LABEL
    stands = result_meanings(function_id or 0, command or "", variant.value)
    return _HANDLE_LABELS.get(name) or ValueLabel(
        text=_all_of("field.meanings", [*map(table_message, stands)])
    )


def _meaning(text: str | None) -> str | Message:
    return table_message(text) if text else ""


def _string_meaning(function_id: int | None, name: str, value: str) -> str | Message:
    if name == "bstrProvider":
        return _meaning(provider_meaning(value))
    if name == "bstrOption":
        found = option_meanings(value, is_move=function_id == ID["Robot_Move"])
        meanings = {key: table_message(text) for key, text in found.items()}
        if len(meanings) == 1:
            return next(iter(meanings.values()))
        return _all_of(
            "field.options",
            [Message("field.option", key=key, meaning=meaning) for key, meaning in meanings.items()],
        )
    return ""


def _all_of(id: str, meanings: Sequence[Message]) -> str | Message:
    """Join several meanings into one message with the message `id`; "" if there are no meanings."""
    if not meanings:
        return ""
    *others, found = meanings
    for each in reversed(others):
        found = Message(id, first=each, rest=found)
    return found


def _first_elements(variant: Variant) -> tuple[Variant, ...]:
    """Return the first four elements of a VARIANT array; () for anything else."""
    value = variant.value
    if variant.vt != ARRAY | VT.VARIANT or not isinstance(value, tuple):
        return ()
    return tuple(item for item in value[:4] if isinstance(item, Variant))


def _pose_label(variant: Variant) -> ValueLabel:
    """Label the parts of a pose that is a VARIANT array: numbers, type, pass and extra axes."""
    items = _first_elements(variant)
    if not items or not items[0].vt & ARRAY:
        return NO_LABEL
    type_, passing = _integer_at(items, 1), _integer_at(items, 2)
    letter = "" if type_ is None else POSE_TYPES.get(type_, "")
    axes = _AXES.get(letter or _text_at(items, 1), ())
    return ValueLabel(
        elements=(
            ValueLabel("numbers", elements=tuple(ValueLabel(axis.name, axis.unit) for axis in axes)),
            ValueLabel("pose type", text=letter),
            ValueLabel("pass", text="" if passing is None else pass_motion_text(passing)),
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
    items = _first_elements(variant)
    if len(items) < 3:
        return NO_LABEL
    number = _integer_at(items, 0)
    interpolation = ValueLabel(
        "interpolation", text="" if number is None else _meaning(INTERPOLATIONS.get(number))
    )
    return ValueLabel(
        elements=(interpolation, _pose_label(items[1])._replace(name="pose"), ValueLabel("distance", "mm"))
    )
