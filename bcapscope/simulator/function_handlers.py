"""The functions that clients call on an object (ids 4 to 137), and the commands of controllers and tasks.

Sources for names, parameters and results of commands: ShoheiKobata/orin_bcap_python_samples,
DENSORobot/denso_robot_ros2, nkawa/Denso_CobottaPro900_MQTT_Control (bits of SysState, fields of an error).
If only a real controller program can fill a field of an error, the field is 0.

The simulator answers E_NOTIMPL to a function without a handler in this module. The C server answers E_NOTIMPL
to a function id without a callback (orin_bcap C/src/bCAPServer/bcap_server.c). DENSO's skeleton of a provider
also answers E_NOTIMPL (CaoProvRobot.cpp, 2003).

Only one source shows which functions are missing, and only for the robot. It is a wrapper of the RC8 provider
(VE026A_JNI.java by Suzuki, 2015) without methods Chuck, Unchuck, GoHome and Drive. The simulator nevertheless
has Drive, because clients need this function. The simulator lacks Rotate, because no source describes the
planes of Rotate.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Mapping, Sequence
from datetime import datetime, timedelta
from typing import TypeAlias

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.tables.hresult import E_INVALIDARG, describe_hresult
from bcapscope.simulator import system_variables
from bcapscope.simulator.argument_values import (
    argument_at,
    boolean,
    bstr,
    bstr_array,
    i2,
    i4,
    integer_of,
    number_of,
    number_within,
    text_of,
    variant_array,
)
from bcapscope.simulator.call_context import CallContext, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import (
    BAD_INDEX,
    EMERGENCY_STOP,
    INVALID_COMMAND,
    OBJECT_NOT_FOUND,
    OUT_OF_MEMORY,
    CallResult,
    HandlerOutcome,
    RefusedError,
    RunningCall,
)
from bcapscope.simulator.equipment_commands import HAND_COMMANDS, HAND_EXTENSION_COMMANDS, LINE_COMMANDS
from bcapscope.simulator.machine import AUTOMATIC, MANUAL, READY, RUNNING, Alarm
from bcapscope.simulator.motion_commands import drive, halt, hold, move, unhold
from bcapscope.simulator.object_table import check_storable
from bcapscope.simulator.robot_commands import PALLET_COMMANDS, ROBOT_COMMANDS

_DAY_0 = datetime(1899, 12, 30)


def _clear_error(context: CallContext, parameter: Variant) -> None:
    if context.machine.emergency:
        raise RefusedError(EMERGENCY_STOP)
    context.machine.clear_errors()


def _current_error_info(context: CallContext, parameter: Variant) -> Variant:
    alarm = _alarm_at(context.machine.active_alarms, integer_of(parameter))
    return variant_array(i4(alarm.code), bstr(alarm.text), i4(0), i4(0), bstr(""), i4(0), i4(0))


def _error_log(context: CallContext, parameter: Variant) -> Variant:
    alarm = _alarm_at(context.machine.alarm_log, integer_of(parameter))
    at = _DAY_0 + timedelta(days=context.machine.date(alarm.time))
    date = (at.year, at.month, at.isoweekday() % 7, at.day)
    clock = (at.hour, at.minute, at.second, at.microsecond // 1000)
    rest = (i4(0), i4(0), i4(0), bstr(alarm.text), i4(alarm.code), i4(0), bstr(""))
    return variant_array(i4(alarm.code), *map(i4, (*date, *clock)), *rest)


def _alarm_at(alarms: Sequence[Alarm], index: int) -> Alarm:
    """Return an error by its index; index 0 is the newest error."""
    if not 0 <= index < len(alarms):
        raise RefusedError(BAD_INDEX)
    return alarms[index]


def _system_state(context: CallContext, parameter: Variant) -> Variant:
    """Run SysState. `enumerations.SYS_STATE_BITS` explains the bits of the result."""
    machine, now = context.machine, context.now
    automatic = machine.mode == AUTOMATIC
    bits = {
        0: RUNNING in machine.tasks.values(),
        1: bool(machine.active_alarms),
        2: machine.motor_is_on(now),
        3: True,
        4: automatic,
        5: automatic,
        10: machine.emergency,
        11: automatic,
        17: True,
        18: machine.mode == MANUAL,
        20: now < machine.arm.ends or not machine.slave.is_empty,
        21: not machine.arm.is_at_rest(now),
    }
    return i4(sum(1 << bit for bit, value in bits.items() if value))


def _put_auto_mode(context: CallContext, parameter: Variant) -> None:
    """Run PutAutoMode of RC7. Its parameter is 1 for internal mode and 2 for external mode."""
    mode = integer_of(parameter)
    if mode not in (1, 2):
        raise RefusedError(E_INVALIDARG)
    context.machine.auto_mode = mode


CONTROLLER_COMMANDS: CommandTable = {
    **HAND_COMMANDS,
    "clearerror": _clear_error,
    # The description of the error is bcapscope's own, not that of a real controller.
    "geterrordescription": lambda context, code: bstr(describe_hresult(integer_of(code)).text),
    "getcurerrorcount": lambda context, _: i4(len(context.machine.active_alarms)),
    "getcurerrorinfo": _current_error_info,
    "geterrorlogcount": lambda context, _: i4(len(context.machine.alarm_log)),
    "geterrorlog": _error_log,
    # SysInfo returns the serial number if the parameter is 0, and an empty text for any other parameter.
    "sysinfo": lambda context, kind: bstr("" if integer_of(kind) else "SIMULATOR"),
    "sysstate": _system_state,
    "stostate": lambda context, _: boolean(context.machine.emergency),
    "manualreset": accept_without_effect,
    "manualresetpreparation": accept_without_effect,
    "resetstostate": accept_without_effect,
    "putautomode": _put_auto_mode,
    "getautomode": lambda context, _: i2(context.machine.auto_mode),
}
"""Handlers of the commands of Controller_Execute, by command name in lower case."""

TASK_COMMANDS: CommandTable = {
    "getstatus": lambda context, _: i4(context.machine.tasks.get(context.object.name.casefold(), READY))
}
"""Handlers of the commands of Task_Execute, by command name in lower case."""


Arguments: TypeAlias = "tuple[Variant, ...]"
"""Arguments of a request, without its handle."""

FunctionHandler: TypeAlias = Callable[[CallContext, Arguments], HandlerOutcome]

MAX_FILES = 100
_EXTENSIONS: Mapping[str, CommandTable] = {
    "Hand0": HAND_EXTENSION_COMMANDS,
    "Comm": LINE_COMMANDS,
    "Pallet": PALLET_COMMANDS,
}
_STATE_DONE = 2


_KNOWN_NAMES: Mapping[ObjectClass, Callable[[CallContext], Container[str]]] = {
    ObjectClass.TASK: lambda context: context.machine.tasks,
    ObjectClass.EXTENSION: lambda context: tuple(map(str.casefold, _EXTENSIONS)),
    ObjectClass.COMMAND: lambda context: CONTROLLER_COMMANDS,
}
"""Existing names, in lower case."""


def open_object(context: CallContext, kind: ObjectClass, arguments: Arguments) -> Variant:
    """Open an object by name; with @IfNotMember, return the handle of an object that is already open."""
    name, option = text_of(argument_at(arguments, 0)), _text_at(arguments, 1)
    _check_name(context, kind, name, option)
    if "@ifnotmember" in option.casefold():
        found = context.objects.find_by_name(kind, name, context.object)
        if found:
            return i4(found.handle)
    return i4(context.objects.open(kind, name, context.object).handle)


def _text_at(arguments: Arguments, index: int) -> str:
    """Read an optional text argument; return "" if it is missing."""
    return text_of(arguments[index]) if index < len(arguments) else ""


def _check_name(context: CallContext, kind: ObjectClass, name: str, option: str) -> None:
    """Refuse the name of an object that the controller does not have. A robot may have any name."""
    machine, folded = context.machine, name.casefold()
    if kind is ObjectClass.VARIABLE:
        system_variables.check_exists(context.object.kind, name, machine.profile.generation)
    elif kind in _KNOWN_NAMES and folded not in _KNOWN_NAMES[kind](context):
        raise RefusedError(OBJECT_NOT_FOUND)
    elif kind is ObjectClass.FILE and folded not in machine.files:
        _create_file(context, name, option)


def _create_file(context: CallContext, name: str, option: str) -> None:
    if not re.search(r"@create\s*=\s*1", option.casefold()) or not name:
        raise RefusedError(OBJECT_NOT_FOUND)
    if len(context.machine.files) >= MAX_FILES or len(name) > 255:
        raise RefusedError(OUT_OF_MEMORY)
    context.machine.files[name.casefold()] = name


def _get_message(context: CallContext, arguments: Arguments) -> Variant:
    """Run Controller_GetMessage, which returns the newest active error. Refuse the call if no error is
    active.
    """
    active = context.machine.active_alarms
    if not active:
        raise RefusedError(OBJECT_NOT_FOUND)
    made, alarm = context.objects.open(ObjectClass.MESSAGE, "", context.object), active[0]
    made.values = {
        "Message_GetNumber": i4(alarm.code),
        "Message_GetDescription": bstr(alarm.text),
        "Message_GetDateTime": Variant(VT.DATE, context.machine.date(alarm.time)),
        "Message_GetSource": bstr(context.object.name),
        "Message_GetDestination": bstr(""),
        "Message_GetSerialNumber": i4(1),
        "Message_GetValue": i4(alarm.code),
    }
    return i4(made.handle)


def command_runner(commands: CommandTable) -> FunctionHandler:
    """Return a handler for an ..._Execute function. If the profile lacks a command, the handler refuses the
    command.
    """

    def execute(context: CallContext, arguments: Arguments) -> HandlerOutcome:
        name = text_of(argument_at(arguments, 0)).casefold()
        if name not in commands or name in context.machine.profile.lacks:
            raise RefusedError(INVALID_COMMAND)
        return commands[name](context, arguments[1] if len(arguments) > 1 else EMPTY)

    return execute


_EXTENSION_HANDLERS = {name.casefold(): command_runner(commands) for name, commands in _EXTENSIONS.items()}


def _command_execute(context: CallContext, arguments: Arguments) -> None:
    """Run the command that a Command object holds; a command that takes time stores no result."""
    values = context.object.values
    outcome = CONTROLLER_COMMANDS[context.object.name.casefold()](context, values.get("parameters", EMPTY))
    if not isinstance(outcome, RunningCall):
        values["result"] = (outcome.value if isinstance(outcome, CallResult) else outcome) or EMPTY


def _stored_value(key: str, default: Variant = EMPTY) -> FunctionHandler:
    return lambda context, arguments: context.object.values.get(key, default)


def _robot_move(context: CallContext, arguments: Arguments) -> HandlerOutcome:
    option = arguments[2] if len(arguments) > 2 else bstr("")
    return move(context, argument_at(arguments, 0), argument_at(arguments, 1), option)


def _robot_drive(context: CallContext, arguments: Arguments) -> HandlerOutcome:
    way = integer_of(argument_at(arguments, 0)), float(number_of(argument_at(arguments, 1)))
    return drive(context, [way], False, _text_at(arguments, 2))


def _robot_speed(context: CallContext, arguments: Arguments) -> None:
    speed = float(number_of(argument_at(arguments, 1)))
    if not 0 < speed <= 100:
        raise RefusedError(E_INVALIDARG)
    context.machine.speeds.internal = speed


def _robot_accelerate(context: CallContext, arguments: Arguments) -> None:
    """Run Robot_Accelerate: parameters two and three are in percent, and -1 keeps the current value."""
    pair = float(number_of(argument_at(arguments, 1))), float(number_of(argument_at(arguments, 2)))
    if not all(value == -1 or 0 < value <= 100 for value in pair):
        raise RefusedError(E_INVALIDARG)
    speeds = context.machine.speeds
    speeds.acceleration = speeds.acceleration if pair[0] == -1 else pair[0]
    speeds.deceleration = speeds.deceleration if pair[1] == -1 else pair[1]


def _robot_change(context: CallContext, arguments: Arguments) -> None:
    match = re.fullmatch(r"(tool|work)([0-9]{1,2})", text_of(argument_at(arguments, 0)).strip().casefold())
    if match is None:
        raise RefusedError(E_INVALIDARG)
    setattr(context.machine, match[1], int(match[2]))


def _task_start(context: CallContext, arguments: Arguments) -> None:
    number_within(argument_at(arguments, 0), range(1, 4), E_INVALIDARG)
    context.machine.start_task(context.object.name)


def _task_stop(context: CallContext, arguments: Arguments) -> None:
    number_within(argument_at(arguments, 0), range(5), E_INVALIDARG)
    context.machine.stop_task(context.object.name, context.now)


def _date(context: CallContext, arguments: Arguments) -> Variant:
    return Variant(VT.DATE, context.machine.date(context.now))


def _put(field: str) -> FunctionHandler:
    return lambda context, arguments: setattr(
        context.object, field, check_storable(argument_at(arguments, 0))
    )


def _variable_names(context: CallContext, arguments: Arguments) -> Variant:
    generation = context.machine.profile.generation
    return bstr_array(system_variables.variable_names(context.object.kind, generation))


_SHARED_HANDLERS: Mapping[str, FunctionHandler] = {
    "GetAttribute": lambda context, _: i4(0),
    "GetHelp": lambda context, _: bstr(""),
    "GetName": lambda context, _: bstr(context.object.name),
    "GetTag": lambda context, _: context.object.tag,
    "PutTag": _put("tag"),
    "GetID": lambda context, _: context.object.id,
    "PutID": _put("id"),
    "Release": lambda context, _: context.objects.release(context.object),
    "Disconnect": lambda context, _: context.objects.release(context.object),
    "GetVariableNames": _variable_names,
}
"""Handlers of the functions that several classes of objects have. The key is the function's name without the
class, such as `GetTag`.
"""

_OWN_HANDLERS: Mapping[str, FunctionHandler] = {
    "Controller_GetMessage": _get_message,
    "Controller_Execute": command_runner(CONTROLLER_COMMANDS),
    "Controller_GetExtensionNames": lambda context, _: bstr_array(_EXTENSIONS),
    "Controller_GetFileNames": lambda context, _: bstr_array(context.machine.files.values()),
    "Controller_GetRobotNames": lambda context, _: bstr_array(("Arm0",)),
    "Controller_GetTaskNames": lambda context, _: bstr_array(context.machine.initial_state.tasks),
    "Controller_GetCommandNames": lambda context, _: bstr_array(CONTROLLER_COMMANDS),
    "File_GetDateCreated": _date,
    "File_GetDateLastAccessed": _date,
    "File_GetDateLastModified": _date,
    "File_GetPath": lambda context, _: bstr(context.object.name),
    "File_GetSize": lambda context, _: i4(0),
    "File_GetType": lambda context, _: bstr(context.object.name.rpartition(".")[2]),
    "File_GetValue": lambda context, _: bstr(""),
    "Extension_Execute": lambda context, arguments: _EXTENSION_HANDLERS[context.object.name.casefold()](
        context, arguments
    ),
    "Robot_Execute": command_runner(ROBOT_COMMANDS),
    "Robot_Accelerate": _robot_accelerate,
    "Robot_Change": _robot_change,
    "Robot_Drive": _robot_drive,
    "Robot_Halt": lambda context, _: halt(context),
    "Robot_Hold": lambda context, _: hold(context),
    "Robot_Move": _robot_move,
    "Robot_Speed": _robot_speed,
    "Robot_Unhold": lambda context, _: unhold(context),
    "Task_Execute": command_runner(TASK_COMMANDS),
    "Task_Start": _task_start,
    "Task_Stop": _task_stop,
    "Task_GetFileName": lambda context, _: bstr(f"{context.object.name}.pac"),
    "Variable_GetDateTime": _date,
    "Variable_GetValue": lambda context, _: system_variables.read_variable(context),
    "Variable_PutValue": lambda context, arguments: system_variables.write_variable(
        context, argument_at(arguments, 0)
    ),
    "Variable_GetMicrosecond": lambda context, _: i4(context.now // 1000 % 1_000_000),
    "Command_Execute": _command_execute,
    "Command_GetTimeout": _stored_value("timeout", i4(0)),
    "Command_PutTimeout": lambda context, arguments: context.object.values.update(
        timeout=i4(integer_of(argument_at(arguments, 0)))
    ),
    "Command_GetState": lambda context, _: i4(_STATE_DONE),
    "Command_GetParameters": _stored_value("parameters"),
    "Command_PutParameters": lambda context, arguments: context.object.values.update(
        parameters=check_storable(argument_at(arguments, 0))
    ),
    "Command_GetResult": _stored_value("result"),
    "Message_Clear": lambda context, _: None,
}


def _handler(function: Function) -> FunctionHandler | None:
    verb = function.name.partition("_")[2]
    kind = function.creates
    if function.name.startswith("Message_Get"):
        return _stored_value(function.name)
    if kind is not None and function.name not in _OWN_HANDLERS:
        return lambda context, arguments: open_object(context, kind, arguments)
    return _OWN_HANDLERS.get(function.name) or _SHARED_HANDLERS.get(verb)


FUNCTION_HANDLERS: Mapping[int, tuple[ObjectClass, FunctionHandler | None]] = {
    function.id: (function.owner, _handler(function)) for function in FUNCTIONS.values() if function.id > 3
}
"""Object class and handler of each function, by function id. The simulator refuses functions without a
handler.
"""
