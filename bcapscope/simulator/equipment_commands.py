"""Commands of Robot_Execute for groups of robots, forces, areas, scenes and buttons, and the extension Comm.

Parameters: ShoheiKobata/orin_bcap_python_samples (SyncTime..., SyncMove..., ForceParam, AutoCal, RobInfo,
buttons, Comm) and DENSO's descriptions quoted in nkawa/Denso_CobottaPro900_MQTT_Control (ForceCtrl,
ForceParam, ForceValue, ForceSensor, areas). The codes of brackets: the list of controller errors there.

No force acts on the simulated robot. It has one arm, so brackets are checked but do not change the motions
between them.
"""

from __future__ import annotations

from types import MappingProxyType

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_ARM_NOT_TAKEN, E_INVALIDARG
from bcapscope.simulator.argument_values import (
    argument_at,
    boolean,
    bstr,
    float_array,
    i4,
    integer_of,
    items_of,
    number_of,
    numbers_of,
    r8,
    variant_array,
)
from bcapscope.simulator.call_context import CallContext, CommandHandler, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import DONE, CallOutcome, CallResult, RefusedError
from bcapscope.simulator.equipment import MAX_AREAS, MAX_LINES
from bcapscope.simulator.result_codes import BAD_INDEX, BRACKET_IS_CLOSED, BRACKET_IS_OPEN

_FORCE_CONTROLS = range(1, 11)
_COORDINATES = range(3)
_MAX_FORCE_VALUES = 14
_BUTTONS = range(3)
_LINE_IS_OPEN = 2
_SIX = (0.0,) * 6


def _open_bracket(name: str) -> CommandHandler:
    def run(context: CallContext, parameter: Variant) -> CallOutcome:
        brackets = context.machine.equipment.brackets
        if name in brackets:
            raise RefusedError(BRACKET_IS_OPEN[name])
        brackets.add(name)
        return DONE

    return run


def _close_bracket(name: str) -> CommandHandler:
    def run(context: CallContext, parameter: Variant) -> CallOutcome:
        brackets = context.machine.equipment.brackets
        if name not in brackets:
            raise RefusedError(BRACKET_IS_CLOSED[name])
        brackets.remove(name)
        return DONE

    return run


def force_control(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run ForceCtrl: on or off, number 1..10, mode. It stays off while the motor is off."""
    items, machine = items_of(parameter), context.machine
    if machine.profile.needs_arm and machine.owner != context.client:
        raise RefusedError(E_ARM_NOT_TAKEN)
    if integer_of(argument_at(items, 0)) == 0:
        machine.equipment.force_control = None
        return DONE
    number = _force_number(argument_at(items, 1))
    machine.equipment.force_control = number if machine.motor_is_on(context.now) else None
    return DONE


def force_parameters(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run ForceParam: number 1..10, coordinates 0..2, six forces, and up to eleven more values."""
    items = items_of(parameter)
    _force_number(argument_at(items, 0))
    if integer_of(argument_at(items, 1)) not in _COORDINATES or len(items) > _MAX_FORCE_VALUES:
        raise RefusedError(E_INVALIDARG)
    if len(numbers_of(argument_at(items, 2))) < len(_SIX):
        raise RefusedError(E_INVALIDARG)
    return DONE


def _force_number(part: Variant) -> int:
    number = integer_of(part)
    if number not in _FORCE_CONTROLS:
        raise RefusedError(E_INVALIDARG)
    return number


def force_value(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run ForceValue: six zeros for any kind of data."""
    integer_of(argument_at(items_of(parameter), 0))
    return CallResult(value=float_array(VT.R8, _SIX))


def force_sensor(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run ForceSensor: 0 resets the sensor; other values are refused."""
    if integer_of(parameter) != 0:
        raise RefusedError(E_INVALIDARG)
    return DONE


def force_sensor_load(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run CurForceSensorPayLoad: mass, centre and inertia, all zero."""
    return CallResult(
        value=variant_array(r8(0.0), float_array(VT.R8, _SIX[:3]), float_array(VT.R8, _SIX[:3]))
    )


def robot_info(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run RobInfo: the type name for parameter 1, an empty text for others."""
    return CallResult(
        value=bstr(context.machine.initial_state.type_name if integer_of(parameter) == 1 else "")
    )


def button_state(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetMechaButtonState or ClearMechaButtonState: the buttons 0 to 2 are never pressed."""
    if integer_of(parameter) not in _BUTTONS:
        raise RefusedError(BAD_INDEX)
    return CallResult(value=i4(0))


def scene_info(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run SceneInfo: scene, sub-scene and an empty name."""
    items = items_of(parameter)
    scene, sub_scene = (integer_of(argument_at(items, index)) for index in (0, 1))
    if (scene, sub_scene) != (0, 0):
        raise RefusedError(BAD_INDEX)
    return CallResult(value=variant_array(i4(0), i4(0), bstr("")))


def switch_area(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run SetAreaEnabled: number, on or off."""
    items, areas = items_of(parameter), context.machine.equipment.areas
    number = _area(argument_at(items, 0))
    (areas.add if number_of(argument_at(items, 1)) else areas.discard)(number)
    return DONE


def area_state(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run GetAreaEnabled."""
    number = _area(argument_at(items_of(parameter), 0))
    return CallResult(value=boolean(number in context.machine.equipment.areas))


def _area(part: Variant) -> int:
    number = integer_of(part)
    if not 0 <= number < MAX_AREAS:
        raise RefusedError(BAD_INDEX)
    return number


def _line(parameter: Variant) -> int:
    number = integer_of(parameter)
    if not 0 <= number < MAX_LINES:
        raise RefusedError(BAD_INDEX)
    return number


def open_line(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run open of the extension Comm: every line exists, and has no device at its other end."""
    context.machine.equipment.lines.add(_line(parameter))
    return DONE


def close_line(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run close of the extension Comm."""
    context.machine.equipment.lines.discard(_line(parameter))
    return DONE


def line_state(context: CallContext, parameter: Variant) -> CallOutcome:
    """Run State of the extension Comm: 2 for an open line, else 0."""
    is_open = _line(parameter) in context.machine.equipment.lines
    return CallResult(value=i4(_LINE_IS_OPEN if is_open else 0))


def _of_line(value: Variant | None) -> CommandHandler:
    """Make a command that checks its line number and returns `value`."""

    def run(context: CallContext, parameter: Variant) -> CallOutcome:
        _line(parameter)
        return CallResult(value=value)

    return run


EQUIPMENT_COMMANDS: CommandTable = MappingProxyType(
    {
        "synctimestart": _open_bracket("time"),
        "synctimeend": _close_bracket("time"),
        "syncmovestart": _open_bracket("move"),
        "syncmoveend": _close_bracket("move"),
        "forcectrl": force_control,
        "forceparam": force_parameters,
        "forcevalue": force_value,
        "forcesensor": force_sensor,
        "curforcesensorpayload": force_sensor_load,
        "forcewaitcondition": accept_without_effect,
        "autocal": accept_without_effect,
        "robinfo": robot_info,
        "getmechabuttonstate": button_state,
        "clearmechabuttonstate": button_state,
        "curscene": lambda context, parameter: CallResult(value=i4(0)),
        "cursubscene": lambda context, parameter: CallResult(value=i4(0)),
        "sceneinfo": scene_info,
        "setareaenabled": switch_area,
        "getareaenabled": area_state,
    }
)
"""Commands of Robot_Execute by their names in lower case."""

LINE_COMMANDS: CommandTable = MappingProxyType(
    {
        "open": open_line,
        "close": close_line,
        "state": line_state,
        "clear": _of_line(None),
        "count": _of_line(i4(0)),
        "input": _of_line(bstr("")),
    }
)
"""Commands of the extension Comm by their names in lower case."""
