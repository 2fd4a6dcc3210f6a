"""What the functions do that are called on an object: 4 to 137.

What is not here answers E_NOTIMPL, as the C server does for an id without callback (orin_bcap
C/src/bCAPServer/bcap_server.c), and as DENSO's skeleton of a provider does for what it leaves out
(CaoProvRobot.cpp, 2003). What a real controller leaves out is documented for the robot only, by the methods
that a wrapper of the RC8 provider has (H. Suzuki, VE026A_JNI.java, 2015): Chuck, Unchuck, GoHome and Drive
are not among them. Drive is here as clients need it; Rotate is not, as no source spells out its planes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import TypeAlias

from bcapscope.protocol.functions import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.hresult import E_INVALIDARG
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.simulator import systemvariables
from bcapscope.simulator.alarms import Alarm
from bcapscope.simulator.context import Command, Commands, Context
from bcapscope.simulator.controllercommands import CONTROLLER_COMMANDS, TASK_COMMANDS
from bcapscope.simulator.equipmentcommands import LINE_COMMANDS
from bcapscope.simulator.framecommands import PALLET_COMMANDS
from bcapscope.simulator.handcommands import HAND_EXTENSION_COMMANDS
from bcapscope.simulator.motions import drive, halt, hold, move, unhold
from bcapscope.simulator.objects import kept
from bcapscope.simulator.outcome import DONE, Answer, Outcome, RefusedError
from bcapscope.simulator.refusals import INVALID_COMMAND, OBJECT_NOT_FOUND, OUT_OF_MEMORY
from bcapscope.simulator.robotcommands import ROBOT_COMMANDS
from bcapscope.simulator.values import bstr, i4, integer_of, names, nth, number_of, text_of

Arguments: TypeAlias = "tuple[Variant, ...]"
"""Of a request, without the handle."""

Handler: TypeAlias = Callable[[Context, Arguments], Outcome]

MOST_FILES = 100
_EXTENSIONS: Mapping[str, Commands] = {
    "Hand0": HAND_EXTENSION_COMMANDS,
    "Comm": LINE_COMMANDS,
    "Pallet": PALLET_COMMANDS,
}
_STATE_DONE = 2


_NAMED: Mapping[ObjectClass, Callable[[Context], Container[str]]] = {
    ObjectClass.TASK: lambda context: context.machine.tasks,
    ObjectClass.EXTENSION: lambda context: tuple(map(str.casefold, _EXTENSIONS)),
    ObjectClass.COMMAND: lambda context: CONTROLLER_COMMANDS,
}
"""Names that there are, in lower case."""


def open_object(context: Context, kind: ObjectClass, arguments: Arguments) -> Outcome:
    """Open an object of a name; with @IfNotMember the one that is open already is used again."""
    name, option = text_of(nth(arguments, 0)), text_of(arguments[1]) if len(arguments) > 1 else ""
    _check_name(context, kind, name, option)
    if "@ifnotmember" in option.casefold():
        found = context.objects.named(kind, name, context.object)
        if found:
            return Answer(value=i4(found.handle))
    return Answer(value=i4(context.objects.open(kind, name, context.object).handle))


def _check_name(context: Context, kind: ObjectClass, name: str, option: str) -> None:
    """Refuse a name that the controller has nothing of; any name does for its one robot."""
    machine, folded = context.machine, name.casefold()
    if kind is ObjectClass.VARIABLE:
        systemvariables.check(context.object.kind, name, machine.profile.generation)
    elif kind in _NAMED and folded not in _NAMED[kind](context):
        raise RefusedError(OBJECT_NOT_FOUND)
    elif kind is ObjectClass.FILE and folded not in machine.files:
        _create_file(context, name, option)


def _create_file(context: Context, name: str, option: str) -> None:
    if not re.search(r"@create\s*=\s*1", option.casefold()) or not name:
        raise RefusedError(OBJECT_NOT_FOUND)
    if len(context.machine.files) >= MOST_FILES or len(name) > 255:
        raise RefusedError(OUT_OF_MEMORY)
    context.machine.files[name.casefold()] = name


def get_message(context: Context, arguments: Arguments) -> Outcome:
    """Run Controller_GetMessage: the newest error is the message; none, no message."""
    active = context.machine.alarms.active
    if not active:
        raise RefusedError(OBJECT_NOT_FOUND)
    made = context.objects.open(ObjectClass.MESSAGE, "", context.object)
    made.values = _message_values(active[0], context)
    return Answer(value=i4(made.handle))


def _message_values(alarm: Alarm, context: Context) -> dict[str, Variant]:
    return {
        "Message_GetNumber": i4(alarm.code),
        "Message_GetDescription": bstr(alarm.text),
        "Message_GetDateTime": Variant(VT.DATE, context.machine.date(alarm.time)),
        "Message_GetSource": bstr(context.object.name),
        "Message_GetDestination": bstr(""),
        "Message_GetSerialNumber": i4(1),
        "Message_GetValue": i4(alarm.code),
    }


def release(context: Context, arguments: Arguments) -> Outcome:
    """Run any of the releases."""
    context.objects.release(context.object)
    return DONE


def executing(commands: Commands) -> Handler:
    """Make what an ..._Execute function does: run one of its commands.

    It refuses a command that the profile lacks.
    """

    @lru_cache(maxsize=256)
    def named(name: str, lacks: frozenset[str]) -> Command:
        folded = name.casefold()
        found = commands.get(folded)
        if found is None or folded in lacks:
            raise RefusedError(INVALID_COMMAND)
        return found

    def execute(context: Context, arguments: Arguments) -> Outcome:
        if not arguments:
            raise RefusedError(E_INVALIDARG)
        run = named(text_of(arguments[0]), context.machine.profile.lacks)
        return run(context, arguments[1] if len(arguments) > 1 else EMPTY)

    return execute


_EXTENSION_HANDLERS = {name.casefold(): executing(commands) for name, commands in _EXTENSIONS.items()}


def _extension_execute(context: Context, arguments: Arguments) -> Outcome:
    return _EXTENSION_HANDLERS[context.object.name.casefold()](context, arguments)


def _command_execute(context: Context, arguments: Arguments) -> Outcome:
    parameter = context.object.values.get("parameters", EMPTY)
    outcome = CONTROLLER_COMMANDS[context.object.name.casefold()](context, parameter)
    if isinstance(outcome, Answer):
        context.object.values["result"] = outcome.value or EMPTY
    return DONE


def _stored(key: str) -> Handler:
    return lambda context, arguments: Answer(value=context.object.values.get(key, EMPTY))


def _put_parameters(context: Context, arguments: Arguments) -> Outcome:
    context.object.values["parameters"] = kept(nth(arguments, 0))
    return DONE


def _put_timeout(context: Context, arguments: Arguments) -> Outcome:
    context.object.values["timeout"] = i4(integer_of(nth(arguments, 0)))
    return DONE


def _robot_move(context: Context, arguments: Arguments) -> Outcome:
    option = arguments[2] if len(arguments) > 2 else Variant(VT.BSTR, "")
    return move(context, nth(arguments, 0), nth(arguments, 1), option)


def _robot_drive(context: Context, arguments: Arguments) -> Outcome:
    way = integer_of(nth(arguments, 0)), float(number_of(nth(arguments, 1)))
    return drive(context, [way], False, text_of(arguments[2]) if len(arguments) > 2 else "")


def _robot_speed(context: Context, arguments: Arguments) -> Outcome:
    speed = float(number_of(nth(arguments, 1)))
    if not 0 < speed <= 100:
        raise RefusedError(E_INVALIDARG)
    context.machine.speeds.internal = speed
    return DONE


def _robot_accelerate(context: Context, arguments: Arguments) -> Outcome:
    pair = float(number_of(nth(arguments, 1))), float(number_of(nth(arguments, 2)))
    if not all(value == -1 or 0 < value <= 100 for value in pair):
        raise RefusedError(E_INVALIDARG)
    speeds = context.machine.speeds
    speeds.acceleration = speeds.acceleration if pair[0] == -1 else pair[0]
    speeds.deceleration = speeds.deceleration if pair[1] == -1 else pair[1]
    return DONE


def _robot_change(context: Context, arguments: Arguments) -> Outcome:
    match = re.fullmatch(r"(tool|work)([0-9]{1,2})", text_of(nth(arguments, 0)).strip().casefold())
    if match is None:
        raise RefusedError(E_INVALIDARG)
    setattr(context.machine, match[1], int(match[2]))
    return DONE


def _task_start(context: Context, arguments: Arguments) -> Outcome:
    if integer_of(nth(arguments, 0)) not in (1, 2, 3):
        raise RefusedError(E_INVALIDARG)
    context.machine.start_task(context.object.name)
    return DONE


def _task_stop(context: Context, arguments: Arguments) -> Outcome:
    if integer_of(nth(arguments, 0)) not in range(5):
        raise RefusedError(E_INVALIDARG)
    context.machine.stop_task(context.object.name, context.now)
    return DONE


def _put_value(context: Context, arguments: Arguments) -> Outcome:
    return systemvariables.write(context, nth(arguments, 0))


def _date(context: Context, arguments: Arguments) -> Outcome:
    return Answer(value=Variant(VT.DATE, context.machine.date(context.now)))


def _put_tag(context: Context, arguments: Arguments) -> Outcome:
    context.object.tag = kept(nth(arguments, 0))
    return DONE


def _put_id(context: Context, arguments: Arguments) -> Outcome:
    context.object.id = kept(nth(arguments, 0))
    return DONE


_OF_ALL: Mapping[str, Handler] = {
    "GetAttribute": lambda context, arguments: Answer(value=i4(0)),
    "GetHelp": lambda context, arguments: Answer(value=bstr("")),
    "GetName": lambda context, arguments: Answer(value=bstr(context.object.name)),
    "GetTag": lambda context, arguments: Answer(value=context.object.tag),
    "PutTag": _put_tag,
    "GetID": lambda context, arguments: Answer(value=context.object.id),
    "PutID": _put_id,
    "Release": release,
    "Disconnect": release,
    "GetVariableNames": lambda context, arguments: Answer(
        value=names(systemvariables.names(context.object.kind, context.machine.profile.generation))
    ),
}
"""By the verb that several classes have."""

_OWN: Mapping[str, Handler] = {
    "Controller_GetMessage": get_message,
    "Controller_Execute": executing(CONTROLLER_COMMANDS),
    "Controller_GetExtensionNames": lambda context, arguments: Answer(value=names(_EXTENSIONS)),
    "Controller_GetFileNames": lambda context, arguments: Answer(value=names(context.machine.files.values())),
    "Controller_GetRobotNames": lambda context, arguments: Answer(value=names(("Arm0",))),
    "Controller_GetTaskNames": lambda context, arguments: Answer(value=names(context.machine.start.tasks)),
    "Controller_GetCommandNames": lambda context, arguments: Answer(value=names(CONTROLLER_COMMANDS)),
    "File_GetDateCreated": _date,
    "File_GetDateLastAccessed": _date,
    "File_GetDateLastModified": _date,
    "File_GetPath": lambda context, arguments: Answer(value=bstr(context.object.name)),
    "File_GetSize": lambda context, arguments: Answer(value=i4(0)),
    "File_GetType": lambda context, arguments: Answer(value=bstr(context.object.name.rpartition(".")[2])),
    "File_GetValue": lambda context, arguments: Answer(value=bstr("")),
    "Extension_Execute": _extension_execute,
    "Robot_Execute": executing(ROBOT_COMMANDS),
    "Robot_Accelerate": _robot_accelerate,
    "Robot_Change": _robot_change,
    "Robot_Drive": _robot_drive,
    "Robot_Halt": lambda context, arguments: halt(context),
    "Robot_Hold": lambda context, arguments: hold(context),
    "Robot_Move": _robot_move,
    "Robot_Speed": _robot_speed,
    "Robot_Unhold": lambda context, arguments: unhold(context),
    "Task_Execute": executing(TASK_COMMANDS),
    "Task_Start": _task_start,
    "Task_Stop": _task_stop,
    "Task_GetFileName": lambda context, arguments: Answer(value=bstr(f"{context.object.name}.pac")),
    "Variable_GetDateTime": _date,
    "Variable_GetValue": lambda context, arguments: Answer(value=systemvariables.read(context)),
    "Variable_PutValue": _put_value,
    "Variable_GetMicrosecond": lambda context, arguments: Answer(value=i4(context.now // 1000 % 1_000_000)),
    "Command_Execute": _command_execute,
    "Command_GetTimeout": lambda context, arguments: Answer(
        value=context.object.values.get("timeout", i4(0))
    ),
    "Command_PutTimeout": _put_timeout,
    "Command_GetState": lambda context, arguments: Answer(value=i4(_STATE_DONE)),
    "Command_GetParameters": _stored("parameters"),
    "Command_PutParameters": _put_parameters,
    "Command_GetResult": _stored("result"),
    "Message_Clear": lambda context, arguments: DONE,
}


def _handler(function: Function) -> Handler | None:
    verb = function.name.partition("_")[2]
    kind = function.creates
    if function.name.startswith("Message_Get"):
        return _stored(function.name)
    if kind is not None and function.name not in _OWN:
        return lambda context, arguments: open_object(context, kind, arguments)
    return _OWN.get(function.name) or _OF_ALL.get(verb)


METHODS: Mapping[int, tuple[ObjectClass, Handler | None]] = MappingProxyType(
    {function.id: (function.owner, _handler(function)) for function in FUNCTIONS.values() if function.id > 3}
)
"""The class that a function is called on, and what it does, by its id; None where it is not implemented."""
