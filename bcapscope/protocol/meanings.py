"""What numbers and strings of arguments and results stand for, where the vendor gives them a name."""

from __future__ import annotations

from collections.abc import Mapping

from bcapscope.protocol.enumerations import (
    AUTO_MODES,
    INTERPOLATIONS,
    POSE_TYPES,
    SPEED_AXES,
    TASK_START_MODES,
    TASK_STOP_MODES,
    options,
    pass_motion,
    provider,
    stands_for,
)
from bcapscope.protocol.functions import ID, ObjectClass
from bcapscope.protocol.parts import UNNAMED, Part
from bcapscope.protocol.poses import AXES
from bcapscope.protocol.variant import ARRAY, VT, Variant

_HANDLES = {f"h{kind}": Part(text=f"handle of a {kind}") for kind in ObjectClass}
_ARGUMENTS: Mapping[tuple[int, str], Mapping[int, str]] = {
    (ID["Robot_Move"], "lComp"): INTERPOLATIONS,
    (ID["Robot_Speed"], "lAxis"): SPEED_AXES,
    (ID["Robot_Accelerate"], "lAxis"): SPEED_AXES,
    (ID["Task_Start"], "lMode"): TASK_START_MODES,
    (ID["Task_Stop"], "lMode"): TASK_STOP_MODES,
}
_PARAMETERS: Mapping[tuple[int, str], Mapping[int, str]] = {
    (ID["Controller_Execute"], "putautomode"): AUTO_MODES
}
_AXES = {str(type_): axes for type_, axes in AXES.items()}


def argument_part(function_id: int | None, command: str | None, name: str, variant: Variant) -> Part:
    """Say what an argument of a request stands for.

    Args:
        function_id: of the request.
        command: its bstrCommand; None where it has none.
        name: of the argument, such as `lComp`.
        variant: the argument.
    """
    value = variant.value
    if type(value) is int:
        named = _ARGUMENTS.get((function_id or 0, name)) or {}
        if name == "vntParam":
            named = _PARAMETERS.get((function_id or 0, (command or "").casefold())) or {}
        return _HANDLES.get(name) or Part(text=named.get(value, ""))
    if isinstance(value, str):
        return Part(text=_string(function_id, name, value))
    if name == "vntPose":
        return _pose(variant)
    if name == "vntParam" and function_id == ID["Robot_Execute"] and (command or "").casefold() == "approach":
        return _approach(variant)
    return UNNAMED


def result_part(function_id: int | None, command: str | None, name: str, variant: Variant) -> Part:
    """Say what a result stands for; the arguments are as those of `argument_part`, of the request."""
    if type(variant.value) is not int:
        return UNNAMED
    stands = stands_for(function_id or 0, command or "", variant.value)
    return _HANDLES.get(name) or Part(text=", ".join(stands))


def _string(function_id: int | None, name: str, value: str) -> str:
    if name == "bstrProvider":
        return provider(value) or ""
    if name == "bstrOption":
        told = options(value, motion=function_id == ID["Robot_Move"])
        return "; ".join(text if len(told) == 1 else f"{key}: {text}" for key, text in told.items())
    return ""


def _items(variant: Variant) -> tuple[Variant, ...]:
    """Return the elements of a VARIANT array, the first ones; () for all else."""
    value = variant.value
    if variant.vt != ARRAY | VT.VARIANT or not isinstance(value, tuple):
        return ()
    return tuple(item for item in value[:4] if isinstance(item, Variant))


def _pose(variant: Variant) -> Part:
    """Name the parts of a pose that is a VARIANT array: numbers, type, pass and extra axes."""
    items = _items(variant)
    if not items or not items[0].vt & ARRAY:
        return UNNAMED
    type_, passing = _number(items, 1), _number(items, 2)
    letter = "" if type_ is None else POSE_TYPES.get(type_, "")
    axes = _AXES.get(letter or _word(items, 1), ())
    return Part(
        parts=(
            Part("numbers", parts=tuple(Part(axis.name, axis.unit) for axis in axes)),
            Part("pose type", text=letter),
            Part("pass", text="" if passing is None else pass_motion(passing)),
            Part("extra axes"),
        )
    )


def _number(items: tuple[Variant, ...], index: int) -> int | None:
    value = items[index].value if index < len(items) else None
    return value if type(value) is int else None


def _word(items: tuple[Variant, ...], index: int) -> str:
    value = items[index].value if index < len(items) else None
    return value.strip().upper() if isinstance(value, str) else ""


def _approach(variant: Variant) -> Part:
    items = _items(variant)
    if len(items) < 3:
        return UNNAMED
    number = _number(items, 0)
    interpolation = Part("interpolation", text="" if number is None else INTERPOLATIONS.get(number, ""))
    return Part(parts=(interpolation, _pose(items[1])._replace(name="pose"), Part("distance", "mm")))
