"""Reading and writing the variables of controller, robot and task objects.

The simulator assumes that clients can write all speed variables.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from bcapscope import __version__
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.slave_mode.modes import Generation, PoseType
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_REFUSED_IN_SLAVE_MODE
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.simulator.argument_values import boolean, bstr, i4, integer_of, number_of, r4
from bcapscope.simulator.call_context import CallContext, CallHandler
from bcapscope.simulator.call_outcome import HandlerOutcome, RefusalCode, RefusedError
from bcapscope.simulator.machine import READY, RUNNING
from bcapscope.simulator.object_table import ControllerObject
from bcapscope.simulator.robot_commands import motor
from bcapscope.simulator.variable_memory import FRAMES, LETTERS, VARIABLES_PER_LETTER

_NUMBERED = re.compile(r"(IO[BWDF]?|[IFDVPJTS]|TOOL|WORK)([0-9]{1,9}|\*)")
_ONLY_ON_RC7 = frozenset(("TOOL", "WORK", "_ITP"))

VariableReader = Callable[[CallContext], Variant]

TYPE_NUMBER = 999
"""Value of the variable @TYPE of the simulated arm. DENSO's arms have other values."""


def check_exists(owner: ObjectClass, name: str, generation: Generation) -> None:
    upper = name.strip().upper()
    match = _NUMBERED.fullmatch(upper) if owner is ObjectClass.CONTROLLER else None
    is_known = match is not None or upper in _READERS.get(owner, ())
    if not is_known or not _exists_on(generation, match[1] if match else upper):
        raise RefusedError(RefusalCode.OBJECT_NOT_FOUND)


def _exists_on(generation: Generation, name: str) -> bool:
    return name not in _ONLY_ON_RC7 or generation is Generation.RC7


def read_variable(context: CallContext) -> Variant:
    place = _numbered_variable(context)
    if place:
        return context.machine.memory.read(*place)
    owner, name = _owner(context).kind, context.object.name.strip().upper()
    if owner is ObjectClass.ROBOT and name in context.machine.initial_state.empty:
        return EMPTY
    return _READERS[owner][name](context)


def write_variable(context: CallContext) -> HandlerOutcome:
    """Write a variable; if the write runs a command, the call lasts as long as the command."""
    context.parameter = context.arguments.at(0)
    place = _numbered_variable(context)
    if place:
        context.machine.memory.write(*place, context.parameter)
        return None
    name = context.object.name.strip().upper()
    command = _WRITE_COMMANDS.get((_owner(context).kind, name))
    if command is None:
        raise RefusedError(RefusalCode.NOT_WRITABLE)
    if context.machine.slave.mode is not None and name in _REFUSED_IN_SLAVE_MODE:
        context.machine.refuse(E_REFUSED_IN_SLAVE_MODE, context.now)
    return command(context)


def variable_names(owner: ObjectClass, generation: Generation) -> tuple[str, ...]:
    """Return the names of an owner's variables. Of numbered variables such as `I0`, `I1` and so on, return
    only the name with the number 0.
    """
    letters = (*LETTERS, *FRAMES) if owner is ObjectClass.CONTROLLER else ()
    return (
        *(f"{letter}0" for letter in letters if _exists_on(generation, letter)),
        *(name for name in _READERS.get(owner, ()) if _exists_on(generation, name)),
    )


def _numbered_variable(context: CallContext) -> tuple[str, int] | None:
    """Return the letter and number of a variable such as `I5`; None for any other variable. If the name has
    `*` instead of a number, as in `I*`, the number is the id that the client stored with PutID.
    """
    match = _NUMBERED.fullmatch(context.object.name.strip().upper())
    if match is None or _owner(context).kind is not ObjectClass.CONTROLLER:
        return None
    if match[2] != "*":
        return match[1], int(match[2])
    stored = context.object.values.get("id", EMPTY)
    if stored.value is None:
        raise RefusedError(RefusalCode.BAD_INDEX)
    return match[1], integer_of(stored)


def _owner(context: CallContext) -> ControllerObject:
    owner = context.object.parent
    assert owner is not None
    return owner


def _pose(pose_type: PoseType) -> VariableReader:
    return lambda context: context.current_pose(pose_type)


def _error_code(context: CallContext) -> Variant:
    active = context.machine.active_alarms
    return i4(active[0].code if active else 0)


def _error_text(context: CallContext) -> Variant:
    active = context.machine.active_alarms
    return bstr(active[0].text if active else "")


def _task_state(context: CallContext) -> Variant:
    return i4(context.machine.tasks.get(_owner(context).name.casefold(), READY))


_SPEEDS: Mapping[str, str] = {
    "@SPEED": "internal",
    "@JSPEED": "internal",
    "@ACCEL": "acceleration",
    "@JACCEL": "acceleration",
    "@DECEL": "deceleration",
    "@JDECEL": "deceleration",
    "@EXTSPEED": "external",
    "@EXTACCEL": "external_acceleration",
    "@EXTDECEL": "external_deceleration",
}


def _put_speed(field: str) -> CallHandler:
    return lambda context: context.machine.speeds.set_percent(
        RefusalCode.NOT_WRITABLE, **{field: float(number_of(context.parameter))}
    )


_WRITE_COMMANDS: Mapping[tuple[ObjectClass, str], CallHandler] = {
    (ObjectClass.ROBOT, "@SERVO_ON"): motor,
    (ObjectClass.TASK, "@START"): lambda context: context.machine.start_task(_owner(context).name),
    (ObjectClass.TASK, "@STOP"): lambda context: context.machine.stop_task(_owner(context).name, context.now),
    **{(ObjectClass.ROBOT, name): _put_speed(field) for name, field in _SPEEDS.items()},
}

_REFUSED_IN_SLAVE_MODE = frozenset(("@SERVO_ON", "@START", "@EXTSPEED", "@EXTACCEL", "@EXTDECEL"))
"""Variables that clients cannot write in slave mode. `is_allowed_in_slave_mode` refuses the commands and
functions that have the same effect, such as Motor and Task_Start.
"""


def _speed(field: str) -> VariableReader:
    return lambda context: r4(getattr(context.machine.speeds, field))


def _fixed(value: Variant) -> VariableReader:
    return lambda context: value


_READERS: Mapping[ObjectClass, Mapping[str, VariableReader]] = {
    ObjectClass.CONTROLLER: {
        SIMULATOR_VARIABLE: _fixed(bstr(SIMULATOR_TEXT)),
        "@MODE": lambda context: i4(context.machine.mode),
        "@ERROR_CODE": _error_code,
        "@ERROR_DESCRIPTION": _error_text,
        "@VERSION": lambda context: bstr(context.machine.profile.version),
        "@FIRMWARE": _fixed(bstr(f"bcapscope {__version__}")),
        "@CURRENT_TIME": lambda context: Variant(VT.DATE, context.machine.date(context.now)),
        "@LOCK": _fixed(boolean(False)),
        "@EMERGENCY_STOP": lambda context: boolean(context.machine.emergency),
        "@BUSY_STATUS": lambda context: boolean(RUNNING in context.machine.tasks.values()),
        "@NORMAL_STATUS": lambda context: boolean(not context.machine.active_alarms),
        "@AUTO_ENABLE": _fixed(boolean(True)),
        "@IO_ALLOC_MODE": _fixed(i4(0)),
        "_ITP": _fixed(i4(0)),
        **{f"@VAR_{letter}_LEN": _fixed(i4(VARIABLES_PER_LETTER)) for letter in LETTERS},
    },
    ObjectClass.ROBOT: {
        "@CURRENT_POSITION": _pose(PoseType.P),
        "@CURRENT_ANGLE": _pose(PoseType.J),
        "@CURRENT_TRANS": _pose(PoseType.T),
        "@HIGH_CURRENT_POSITION": _pose(PoseType.P),
        "@HIGH_CURRENT_ANGLE": _pose(PoseType.J),
        "@SERVO_ON": lambda context: boolean(context.machine.motor_is_on(context.now)),
        "@BUSY_STATUS": lambda context: boolean(not context.machine.arm.is_at_rest(context.now)),
        **{name: _speed(field) for name, field in _SPEEDS.items()},
        "@TYPE": _fixed(i4(TYPE_NUMBER)),
        "@TYPE_NAME": lambda context: bstr(context.machine.initial_state.type_name),
        "@CURRENT_TOOL": lambda context: i4(context.machine.tool),
        "@CURRENT_WORK": lambda context: i4(context.machine.work),
    },
    ObjectClass.TASK: {"@STATUS": _task_state, "@START": _task_state, "@STOP": _task_state},
}
