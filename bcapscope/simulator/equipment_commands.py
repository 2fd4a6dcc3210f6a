"""Commands of Robot_Execute for groups of robots, forces, areas, scenes and buttons, and the extension Comm.

Sources for parameters: ShoheiKobata/orin_bcap_python_samples (SyncTime..., SyncMove..., ForceParam, AutoCal,
RobInfo, buttons, Comm) and DENSO's descriptions quoted in nkawa/Denso_CobottaPro900_MQTT_Control (ForceCtrl,
ForceParam, ForceValue, ForceSensor, areas). Source for the codes of brackets: the list of controller errors
in nkawa/Denso_CobottaPro900_MQTT_Control.

No force acts on the simulated robot. The simulator has one arm, so brackets are checked but do not change the
motions between them.
"""

from __future__ import annotations

from functools import partial

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG
from bcapscope.simulator.argument_values import (
    argument_at,
    boolean,
    bstr,
    float_array,
    i4,
    integer_of,
    items_of,
    number_of,
    number_within,
    numbers_of,
    r8,
    variant_array,
)
from bcapscope.simulator.call_context import CallContext, CommandHandler, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import RefusedError
from bcapscope.simulator.equipment import MAX_AREAS, MAX_LINES
from bcapscope.simulator.result_codes import BAD_INDEX, BRACKET_IS_CLOSED, BRACKET_IS_OPEN

_FORCE_CONTROLS = range(1, 11)
_COORDINATES = range(3)
_MAX_FORCE_VALUES = 14
_BUTTONS = range(3)
_LINE_IS_OPEN = 2
_SIX = (0.0,) * 6


def _open_bracket(context: CallContext, parameter: Variant, name: str) -> None:
    brackets = context.machine.equipment.brackets
    if name in brackets:
        raise RefusedError(BRACKET_IS_OPEN[name])
    brackets.add(name)


def _close_bracket(context: CallContext, parameter: Variant, name: str) -> None:
    brackets = context.machine.equipment.brackets
    if name not in brackets:
        raise RefusedError(BRACKET_IS_CLOSED[name])
    brackets.remove(name)


def _force_control(context: CallContext, parameter: Variant) -> None:
    """Run ForceCtrl: on or off, number 1..10, mode. Force control stays off while the motor is off."""
    items, machine = items_of(parameter), context.machine
    machine.check_arm(context.client)
    if integer_of(argument_at(items, 0)) == 0:
        machine.equipment.force_control = None
        return
    number = number_within(argument_at(items, 1), _FORCE_CONTROLS, E_INVALIDARG)
    machine.equipment.force_control = number if machine.motor_is_on(context.now) else None


def _force_parameters(context: CallContext, parameter: Variant) -> None:
    """Run ForceParam with number 1..10, coordinates 0..2, six forces, and up to eleven more values."""
    items = items_of(parameter)
    number_within(argument_at(items, 0), _FORCE_CONTROLS, E_INVALIDARG)
    number_within(argument_at(items, 1), _COORDINATES, E_INVALIDARG)
    if len(items) > _MAX_FORCE_VALUES or len(numbers_of(argument_at(items, 2))) < len(_SIX):
        raise RefusedError(E_INVALIDARG)


def _force_value(context: CallContext, parameter: Variant) -> Variant:
    """Run ForceValue, which returns six zeros for any kind of data."""
    integer_of(argument_at(items_of(parameter), 0))
    return float_array(VT.R8, _SIX)


def _force_sensor(context: CallContext, parameter: Variant) -> None:
    """Run ForceSensor, whose parameter 0 resets the sensor; refuse other values."""
    if integer_of(parameter) != 0:
        raise RefusedError(E_INVALIDARG)


def _button_state(context: CallContext, parameter: Variant) -> Variant:
    """Run GetMechaButtonState or ClearMechaButtonState; the buttons 0 to 2 are never pressed."""
    number_within(parameter, _BUTTONS, BAD_INDEX)
    return i4(0)


def _scene_info(context: CallContext, parameter: Variant) -> Variant:
    """Run SceneInfo, which returns scene, sub-scene and an empty name."""
    items = items_of(parameter)
    if any([integer_of(argument_at(items, index)) for index in (0, 1)]):
        raise RefusedError(BAD_INDEX)
    return variant_array(i4(0), i4(0), bstr(""))


def _switch_area(context: CallContext, parameter: Variant) -> None:
    """Run SetAreaEnabled, whose parameters are the area's number and on or off."""
    areas = context.machine.equipment.areas
    (areas.add if number_of(argument_at(items_of(parameter), 1)) else areas.discard)(_area(parameter))


def _area(parameter: Variant) -> int:
    return number_within(argument_at(items_of(parameter), 0), range(MAX_AREAS), BAD_INDEX)


def _line(parameter: Variant) -> int:
    return number_within(parameter, range(MAX_LINES), BAD_INDEX)


def _of_line(value: Variant | None) -> CommandHandler:
    """Make a command that checks its line number and returns `value`."""

    def run(context: CallContext, parameter: Variant) -> Variant | None:
        _line(parameter)
        return value

    return run


EQUIPMENT_COMMANDS: CommandTable = {
    "synctimestart": partial(_open_bracket, name="time"),
    "synctimeend": partial(_close_bracket, name="time"),
    "syncmovestart": partial(_open_bracket, name="move"),
    "syncmoveend": partial(_close_bracket, name="move"),
    "forcectrl": _force_control,
    "forceparam": _force_parameters,
    "forcevalue": _force_value,
    "forcesensor": _force_sensor,
    # Mass, centre and inertia.
    "curforcesensorpayload": lambda context, _: variant_array(
        r8(0.0), float_array(VT.R8, _SIX[:3]), float_array(VT.R8, _SIX[:3])
    ),
    "forcewaitcondition": accept_without_effect,
    "autocal": accept_without_effect,
    # RobInfo returns the type name for 1, and an empty text for other numbers.
    "robinfo": lambda context, kind: bstr(
        context.machine.initial_state.type_name if integer_of(kind) == 1 else ""
    ),
    "getmechabuttonstate": _button_state,
    "clearmechabuttonstate": _button_state,
    "curscene": lambda context, _: i4(0),
    "cursubscene": lambda context, _: i4(0),
    "sceneinfo": _scene_info,
    "setareaenabled": _switch_area,
    "getareaenabled": lambda context, area: boolean(_area(area) in context.machine.equipment.areas),
}
"""Handlers of the commands of Robot_Execute by the commands' names in lower case."""

LINE_COMMANDS: CommandTable = {
    # Every line number exists, and no line has a device at its other end.
    "open": lambda context, line: context.machine.equipment.lines.add(_line(line)),
    "close": lambda context, line: context.machine.equipment.lines.discard(_line(line)),
    "state": lambda context, line: i4(_LINE_IS_OPEN if _line(line) in context.machine.equipment.lines else 0),
    "clear": _of_line(None),
    "count": _of_line(i4(0)),
    "input": _of_line(bstr("")),
}
"""Handlers of the commands of the extension Comm by the commands' names in lower case."""
