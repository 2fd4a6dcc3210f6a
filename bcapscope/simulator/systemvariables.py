"""Reading and writing the variables of controller, robot and task objects.

Names and types: `bcapscope.protocol.variables`. DENSO's ROS drivers write @SERVO_ON and @EXTSPEED, and their
configuration lists @START and @STOP as writable (DENSORobot/denso_robot_ros2 denso_robot_core/config). That
the other speeds can be written is assumed. TOOLn, WORKn and _ITP were seen on RC7 only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from bcapscope import __version__
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.hresult import E_REFUSED_IN_SLAVE_MODE
from bcapscope.protocol.simulated import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.slavemode import Generation, PoseType
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.simulator.context import Command, Context
from bcapscope.simulator.equipment import Frame
from bcapscope.simulator.framecommands import NOWHERE, frame_number
from bcapscope.simulator.kinematics import pose_of
from bcapscope.simulator.machine import READY, RUNNING
from bcapscope.simulator.memory import COUNT, LETTERS, vector_of
from bcapscope.simulator.objects import Object
from bcapscope.simulator.outcome import DONE, Outcome, RefusedError
from bcapscope.simulator.refusals import BAD_INDEX, NOT_WRITABLE, OBJECT_NOT_FOUND
from bcapscope.simulator.robotcommands import motor
from bcapscope.simulator.values import boolean, bstr, i4, integer_of, number_of, r4, row

_NUMBERED = re.compile(r"(IO[BWDF]?|[IFDVPJTS]|TOOL|WORK)([0-9]{1,9}|\*)")
_ONLY_ON_RC7 = frozenset(("TOOL", "WORK", "_ITP"))
_FRAMES: Mapping[str, Callable[[Context], dict[int, Frame]]] = {
    "TOOL": lambda context: context.machine.equipment.tools,
    "WORK": lambda context: context.machine.equipment.works,
}

Read = Callable[[Context], Variant]

TYPE_NUMBER = 999
"""Value of @TYPE; DENSO's arms have others."""


def check(owner: ObjectClass, name: str, generation: Generation) -> None:
    """Refuse a variable that the object does not have on a controller of this generation.

    Raises:
        RefusedError: there is none of that name or number.
    """
    upper = name.strip().upper()
    match = _NUMBERED.fullmatch(upper) if owner is ObjectClass.CONTROLLER else None
    is_known = match is not None or (owner, upper) in _READERS
    if not is_known or not _is_on(generation, match[1] if match else upper):
        raise RefusedError(OBJECT_NOT_FOUND)


def _is_on(generation: Generation, name: str) -> bool:
    return name not in _ONLY_ON_RC7 or generation is Generation.RC7


def read(context: Context) -> Variant:
    """Read the variable of `context.object`."""
    place = _place(context.object)
    if place and place[0] in _FRAMES:
        return _read_frame(context, *place)
    if place:
        return context.machine.memory.read(*place)
    owner, name = _owner(context.object), context.object.name.strip().upper()
    if owner is ObjectClass.ROBOT and name in context.machine.start.empty:
        return EMPTY
    return _READERS[owner, name](context)


def write(context: Context, value: Variant) -> Outcome:
    """Write the variable of `context.object`; one that acts as a command runs as long as the command.

    Raises:
        RefusedError: it cannot be written, the value does not fit, or the command is refused.
    """
    place = _place(context.object)
    if place and place[0] in _FRAMES:
        return _write_frame(context, *place, value)
    if place:
        context.machine.memory.write(*place, value)
        return DONE
    name = context.object.name.strip().upper()
    act = _ACTS.get((_owner(context.object), name))
    if act is None:
        raise RefusedError(NOT_WRITABLE)
    if context.machine.slave.mode is not None and not act.in_slave_mode:
        context.machine.refuse(E_REFUSED_IN_SLAVE_MODE, context.now)
    return act.command(context, value)


def names(owner: ObjectClass, generation: Generation) -> tuple[str, ...]:
    """List the variables of an object, the numbered ones by their first."""
    letters = (*LETTERS, *_FRAMES) if owner is ObjectClass.CONTROLLER else ()
    named = (name for kind, name in _READERS if kind is owner)
    return (
        *(f"{letter}0" for letter in letters if _is_on(generation, letter)),
        *(name for name in named if _is_on(generation, name)),
    )


def _read_frame(context: Context, kind: str, number: int) -> Variant:
    frame = _FRAMES[kind](context).get(frame_number(number), NOWHERE)
    return row(context.machine.profile.real, frame)


def _write_frame(context: Context, kind: str, number: int, value: Variant) -> Outcome:
    """Define a tool or work; a seventh number, the Fig of a position, is dropped."""
    frame = vector_of(value, 7, context.machine.profile.real)[:6]
    _FRAMES[kind](context)[frame_number(number, first=1)] = frame
    return DONE


def _place(variable: Object) -> tuple[str, int] | None:
    """Return letter and number of a numbered variable; a `*` takes its number from the ID."""
    match = _NUMBERED.fullmatch(variable.name.strip().upper())
    if match is None or _owner(variable) is not ObjectClass.CONTROLLER:
        return None
    if match[2] != "*":
        return match[1], int(match[2])
    if variable.id.value is None:
        raise RefusedError(BAD_INDEX)
    return match[1], integer_of(variable.id)


def _owner(variable: Object) -> ObjectClass:
    return variable.parent.kind if variable.parent else ObjectClass.CONTROLLER


def _pose(pose_type: PoseType) -> Read:
    return lambda context: row(
        context.machine.profile.real, pose_of(pose_type, context.machine.arm.actual(context.now))
    )


def _error_code(context: Context) -> Variant:
    active = context.machine.alarms.active
    return i4(active[0].code if active else 0)


def _error_text(context: Context) -> Variant:
    active = context.machine.alarms.active
    return bstr(active[0].text if active else "")


def _task_state(context: Context) -> Variant:
    task = context.object.parent
    return i4(context.machine.tasks.get(task.name.casefold(), READY) if task else 0)


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


def _put_speed(field: str) -> Command:
    def run(context: Context, value: Variant) -> Outcome:
        speed = float(number_of(value))
        if not 0 < speed <= 100:
            raise RefusedError(NOT_WRITABLE)
        setattr(context.machine.speeds, field, speed)
        return DONE

    return run


def _start_task(context: Context, value: Variant) -> Outcome:
    context.machine.start_task(_task_name(context))
    return DONE


def _stop_task(context: Context, value: Variant) -> Outcome:
    context.machine.stop_task(_task_name(context), context.now)
    return DONE


def _task_name(context: Context) -> str:
    task = context.object.parent
    return task.name if task else ""


class _Act(NamedTuple):
    """What writing a variable does.

    Attributes:
        command: takes the value that is written as its parameter.
        in_slave_mode: slave mode allows it, as it allows the function or command of the same effect.
    """

    command: Command
    in_slave_mode: bool


_ACTS: Mapping[tuple[ObjectClass, str], _Act] = MappingProxyType(
    {
        (ObjectClass.ROBOT, "@SERVO_ON"): _Act(motor, False),
        (ObjectClass.TASK, "@START"): _Act(_start_task, False),
        (ObjectClass.TASK, "@STOP"): _Act(_stop_task, True),
        **{
            (ObjectClass.ROBOT, name): _Act(_put_speed(field), not name.startswith("@EXT"))
            for name, field in _SPEEDS.items()
        },
    }
)
"""Variables that do what a command or function does when they are written: Motor, Task_Start, ExtSpeed."""


def _speed(field: str) -> Read:
    return lambda context: r4(getattr(context.machine.speeds, field))


def _fixed(value: Variant) -> Read:
    return lambda context: value


_CONTROLLER: dict[str, Read] = {
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
    "@NORMAL_STATUS": lambda context: boolean(not context.machine.alarms.active),
    "@AUTO_ENABLE": _fixed(boolean(True)),
    "@IO_ALLOC_MODE": _fixed(i4(0)),
    "_ITP": _fixed(i4(0)),
    **{f"@VAR_{letter}_LEN": _fixed(i4(COUNT)) for letter in LETTERS},
}

_ROBOT: dict[str, Read] = {
    "@CURRENT_POSITION": _pose(PoseType.P),
    "@CURRENT_ANGLE": _pose(PoseType.J),
    "@CURRENT_TRANS": _pose(PoseType.T),
    "@HIGH_CURRENT_POSITION": _pose(PoseType.P),
    "@HIGH_CURRENT_ANGLE": _pose(PoseType.J),
    "@SERVO_ON": lambda context: boolean(context.machine.motor_is_on(context.now)),
    "@BUSY_STATUS": lambda context: boolean(not context.machine.arm.stands(context.now)),
    **{name: _speed(field) for name, field in _SPEEDS.items()},
    "@TYPE": _fixed(i4(TYPE_NUMBER)),
    "@TYPE_NAME": lambda context: bstr(context.machine.start.type_name),
    "@CURRENT_TOOL": lambda context: i4(context.machine.tool),
    "@CURRENT_WORK": lambda context: i4(context.machine.work),
}

_TASK: dict[str, Read] = {"@STATUS": _task_state, "@START": _task_state, "@STOP": _task_state}

_READERS: Mapping[tuple[ObjectClass, str], Read] = MappingProxyType(
    {
        (owner, name): reader
        for owner, readers in (
            (ObjectClass.CONTROLLER, _CONTROLLER),
            (ObjectClass.ROBOT, _ROBOT),
            (ObjectClass.TASK, _TASK),
        )
        for name, reader in readers.items()
    }
)
