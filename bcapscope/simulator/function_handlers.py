"""The functions that clients call on an object (ids 4 to 137), and the commands of controllers and tasks.

A function without a handler returns E_NOTIMPL. Some fields of an error describe the program that caused the
error; in the simulator, these fields are 0 or empty.

DENSO's provider for RC8 lacks the function Robot_Drive (VE026A_JNI.java by Suzuki, 2015). The simulator has
Robot_Drive in every profile, because clients need this function. The simulator lacks Robot_Rotate, because no
document describes the planes in which Robot_Rotate turns.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from datetime import datetime, timedelta
from functools import partial

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.tables.hresult import E_INVALIDARG, describe_hresult
from bcapscope.simulator import system_variables
from bcapscope.simulator.argument_values import (
    boolean,
    bstr,
    bstr_array,
    i2,
    i4,
    integer_of,
    number_within,
    variant_array,
)
from bcapscope.simulator.call_context import CallContext, CallHandler, CommandTable, accept_without_effect
from bcapscope.simulator.call_outcome import (
    CallResult,
    HandlerOutcome,
    RefusalCode,
    RefusedError,
    RunningCall,
)
from bcapscope.simulator.equipment_commands import HAND_COMMANDS, HAND_EXTENSION_COMMANDS, LINE_COMMANDS
from bcapscope.simulator.machine import AUTOMATIC, MANUAL, READY, RUNNING, Alarm
from bcapscope.simulator.motion_commands import drive, halt, hold, move, unhold
from bcapscope.simulator.object_table import check_storable
from bcapscope.simulator.robot_commands import PALLET_COMMANDS, ROBOT_COMMANDS

_DAY_0 = datetime(1899, 12, 30)


def _clear_error(context: CallContext) -> None:
    if context.machine.emergency:
        raise RefusedError(RefusalCode.EMERGENCY_STOP)
    context.machine.clear_errors()


def _current_error_info(context: CallContext) -> Variant:
    alarm = _chosen_alarm(context, context.machine.active_alarms)
    return variant_array(i4(alarm.code), bstr(alarm.text), i4(0), i4(0), bstr(""), i4(0), i4(0))


def _error_log(context: CallContext) -> Variant:
    alarm = _chosen_alarm(context, context.machine.alarm_log)
    at = _DAY_0 + timedelta(days=context.machine.date(alarm.time))
    date = (at.year, at.month, at.isoweekday() % 7, at.day)
    clock = (at.hour, at.minute, at.second, at.microsecond // 1000)
    rest = (i4(0), i4(0), i4(0), bstr(alarm.text), i4(alarm.code), i4(0), bstr(""))
    return variant_array(i4(alarm.code), *map(i4, (*date, *clock)), *rest)


def _chosen_alarm(context: CallContext, alarms: Sequence[Alarm]) -> Alarm:
    return alarms[number_within(context.parameter, range(len(alarms)), RefusalCode.BAD_INDEX)]


def _system_state(context: CallContext) -> Variant:
    """`enumerations.SYS_STATE_BITS` explains the bits."""
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


def _put_auto_mode(context: CallContext) -> None:
    """Set the mode of an RC7: 1 for internal mode and 2 for external mode."""
    context.machine.auto_mode = number_within(context.parameter, range(1, 3), E_INVALIDARG)


CONTROLLER_COMMANDS: CommandTable = {
    **HAND_COMMANDS,
    "clearerror": _clear_error,
    # The description of the error is bcapscope's own, not that of a real controller.
    "geterrordescription": lambda context: bstr(describe_hresult(integer_of(context.parameter)).text),
    "getcurerrorcount": lambda context: i4(len(context.machine.active_alarms)),
    "getcurerrorinfo": _current_error_info,
    "geterrorlogcount": lambda context: i4(len(context.machine.alarm_log)),
    "geterrorlog": _error_log,
    # SysInfo returns the serial number if the parameter is 0, and an empty text for any other parameter.
    "sysinfo": lambda context: bstr("" if integer_of(context.parameter) else "SIMULATOR"),
    "sysstate": _system_state,
    "stostate": lambda context: boolean(context.machine.emergency),
    "manualreset": accept_without_effect,
    "manualresetpreparation": accept_without_effect,
    "resetstostate": accept_without_effect,
    "putautomode": _put_auto_mode,
    "getautomode": lambda context: i2(context.machine.auto_mode),
}

TASK_COMMANDS: CommandTable = {
    "getstatus": lambda context: i4(context.machine.tasks.get(context.object.name.casefold(), READY))
}


MAX_FILES = 100
_EXTENSIONS: Mapping[str, CommandTable] = {
    "Hand0": HAND_EXTENSION_COMMANDS,
    "Comm": LINE_COMMANDS,
    "Pallet": PALLET_COMMANDS,
}
_STATE_DONE = 2


def open_object(context: CallContext, kind: ObjectClass) -> Variant:
    """Open an object by name; with @IfNotMember, return the handle of an object that is already open."""
    name, option = context.arguments.text(0), context.arguments.text(1, default="")
    _check_name(context, kind, name, option)
    return i4(context.objects.open_named(kind, name, context.object, option).handle)


def _check_name(context: CallContext, kind: ObjectClass, name: str, option: str) -> None:
    """Refuse an object that the controller does not have. A robot may have any name."""
    machine, folded = context.machine, name.casefold()
    known: Mapping[ObjectClass, Container[str]] = {
        ObjectClass.TASK: machine.tasks,
        ObjectClass.EXTENSION: _EXTENSION_HANDLERS,
        ObjectClass.COMMAND: CONTROLLER_COMMANDS,
    }
    if kind is ObjectClass.VARIABLE:
        system_variables.check_exists(context.object.kind, name, machine.profile.generation)
    elif kind in known and folded not in known[kind]:
        raise RefusedError(RefusalCode.OBJECT_NOT_FOUND)
    elif kind is ObjectClass.FILE and folded not in machine.files:
        _create_file(context, name, option)


def _create_file(context: CallContext, name: str, option: str) -> None:
    if not re.search(r"@create\s*=\s*1", option.casefold()) or not name:
        raise RefusedError(RefusalCode.OBJECT_NOT_FOUND)
    if len(context.machine.files) >= MAX_FILES or len(name) > 255:
        raise RefusedError(RefusalCode.OUT_OF_MEMORY)
    context.machine.files[name.casefold()] = name


def _get_message(context: CallContext) -> Variant:
    """Return the handle of a message with the newest active error; refuse the call if no error is active."""
    active = context.machine.active_alarms
    if not active:
        raise RefusedError(RefusalCode.OBJECT_NOT_FOUND)
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


def command_runner(commands: CommandTable) -> CallHandler:
    def execute(context: CallContext) -> HandlerOutcome:
        arguments = context.arguments
        name = arguments.text(0).casefold()
        if name not in commands or name in context.machine.profile.lacks:
            raise RefusedError(RefusalCode.INVALID_COMMAND)
        if len(arguments) > 1:
            context.parameter = arguments[1]
        return commands[name](context)

    return execute


_EXTENSION_HANDLERS = {name.casefold(): command_runner(commands) for name, commands in _EXTENSIONS.items()}


def _command_execute(context: CallContext) -> None:
    """Run the command of a Command object; a command that takes time stores no result."""
    values = context.object.values
    context.parameter = values.get("parameters", EMPTY)
    outcome = CONTROLLER_COMMANDS[context.object.name.casefold()](context)
    if not isinstance(outcome, RunningCall):
        values["result"] = (outcome.value if isinstance(outcome, CallResult) else outcome) or EMPTY


def _stored_value(key: str, default: Variant = EMPTY) -> CallHandler:
    return lambda context: context.object.values.get(key, default)


def _robot_speed(context: CallContext) -> None:
    context.machine.speeds.set_percent(E_INVALIDARG, internal=context.arguments.number(1))


def _robot_accelerate(context: CallContext) -> None:
    """Parameters two and three, acceleration and deceleration, are in percent; -1 keeps the current value."""
    given = {"acceleration": context.arguments.number(1), "deceleration": context.arguments.number(2)}
    changed = {name: value for name, value in given.items() if value != -1}
    context.machine.speeds.set_percent(E_INVALIDARG, **changed)


def _robot_change(context: CallContext) -> None:
    match = re.fullmatch(r"(tool|work)([0-9]{1,2})", context.arguments.text(0).strip().casefold())
    if match is None:
        raise RefusedError(E_INVALIDARG)
    setattr(context.machine, match[1], int(match[2]))


def _task_start(context: CallContext) -> None:
    number_within(context.arguments.at(0), range(1, 4), E_INVALIDARG)
    context.machine.start_task(context.object.name)


def _task_stop(context: CallContext) -> None:
    number_within(context.arguments.at(0), range(5), E_INVALIDARG)
    context.machine.stop_task(context.object.name, context.now)


def _date(context: CallContext) -> Variant:
    return Variant(VT.DATE, context.machine.date(context.now))


def _put_value(key: str) -> CallHandler:
    return lambda context: context.object.values.update({key: check_storable(context.arguments.at(0))})


def _variable_names(context: CallContext) -> Variant:
    generation = context.machine.profile.generation
    return bstr_array(system_variables.variable_names(context.object.kind, generation))


_HANDLERS: Mapping[str, CallHandler] = {
    # functions of several object classes; the key is the name without the class, such as `GetTag`
    "GetAttribute": lambda context: i4(0),
    "GetHelp": lambda context: bstr(""),
    "GetName": lambda context: bstr(context.object.name),
    "GetTag": _stored_value("tag"),
    "PutTag": _put_value("tag"),
    "GetID": _stored_value("id"),
    "PutID": _put_value("id"),
    "Release": lambda context: context.objects.release(context.object),
    "Disconnect": lambda context: context.objects.release(context.object),
    "GetVariableNames": _variable_names,
    "Controller_GetMessage": _get_message,
    "Controller_Execute": command_runner(CONTROLLER_COMMANDS),
    "Controller_GetExtensionNames": lambda context: bstr_array(_EXTENSIONS),
    "Controller_GetFileNames": lambda context: bstr_array(context.machine.files.values()),
    "Controller_GetRobotNames": lambda context: bstr_array(("Arm0",)),
    "Controller_GetTaskNames": lambda context: bstr_array(context.machine.initial_state.tasks),
    "Controller_GetCommandNames": lambda context: bstr_array(CONTROLLER_COMMANDS),
    "File_GetDateCreated": _date,
    "File_GetDateLastAccessed": _date,
    "File_GetDateLastModified": _date,
    "File_GetPath": lambda context: bstr(context.object.name),
    "File_GetSize": lambda context: i4(0),
    "File_GetType": lambda context: bstr(context.object.name.rpartition(".")[2]),
    "File_GetValue": lambda context: bstr(""),
    "Extension_Execute": lambda context: _EXTENSION_HANDLERS[context.object.name.casefold()](context),
    "Robot_Execute": command_runner(ROBOT_COMMANDS),
    "Robot_Accelerate": _robot_accelerate,
    "Robot_Change": _robot_change,
    "Robot_Drive": drive,
    "Robot_Halt": halt,
    "Robot_Hold": hold,
    "Robot_Move": move,
    "Robot_Speed": _robot_speed,
    "Robot_Unhold": unhold,
    "Task_Execute": command_runner(TASK_COMMANDS),
    "Task_Start": _task_start,
    "Task_Stop": _task_stop,
    "Task_GetFileName": lambda context: bstr(f"{context.object.name}.pac"),
    "Variable_GetDateTime": _date,
    "Variable_GetValue": system_variables.read_variable,
    "Variable_PutValue": system_variables.write_variable,
    "Variable_GetMicrosecond": lambda context: i4(context.now // 1000 % 1_000_000),
    "Command_Execute": _command_execute,
    "Command_GetTimeout": _stored_value("timeout", i4(0)),
    "Command_PutTimeout": lambda context: context.object.values.update(
        timeout=i4(context.arguments.integer(0))
    ),
    "Command_GetState": lambda context: i4(_STATE_DONE),
    "Command_GetParameters": _stored_value("parameters"),
    "Command_PutParameters": _put_value("parameters"),
    "Command_GetResult": _stored_value("result"),
    "Message_Clear": accept_without_effect,
}


def _handler(function: Function) -> CallHandler | None:
    if function.name.startswith("Message_Get"):
        return _stored_value(function.name)
    if function.creates is not None and function.name not in _HANDLERS:
        return partial(open_object, kind=function.creates)
    return _HANDLERS.get(function.name) or _HANDLERS.get(function.name.partition("_")[2])


FUNCTION_HANDLERS: Mapping[int, tuple[ObjectClass, CallHandler | None]] = {
    function.id: (function.owner, _handler(function)) for function in FUNCTIONS.values() if function.id > 3
}
"""Object class and handler of each function id; a function without a handler is refused."""
