"""Reading and writing the variables of controller, robot and task objects.

Names and types: `bcapscope.protocol.variables`. DENSO's ROS drivers write @SERVO_ON and @EXTSPEED, and their
configuration lists @START and @STOP as writable (DENSORobot/denso_robot_ros2 denso_robot_core/config). That
the other speeds can be written is assumed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType

from bcapscope import __version__
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.hresult import E_REFUSED_IN_SLAVE_MODE
from bcapscope.protocol.simulated import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.slavemode import PoseType
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.simulator.context import Command, Context
from bcapscope.simulator.kinematics import pose_of
from bcapscope.simulator.machine import READY, RUNNING
from bcapscope.simulator.memory import COUNT, LETTERS
from bcapscope.simulator.objects import Object
from bcapscope.simulator.outcome import DONE, Outcome, RefusedError
from bcapscope.simulator.refusals import BAD_INDEX, NOT_WRITABLE, OBJECT_NOT_FOUND
from bcapscope.simulator.robotcommands import motor
from bcapscope.simulator.values import boolean, bstr, i4, integer_of, number_of, r4, row

_NUMBERED = re.compile(r"(IO[BWDF]?|[IFDVPJTS])([0-9]{1,9}|\*)")

Read = Callable[[Context], Variant]

TYPE_NUMBER = 999
"""Value of @TYPE; DENSO's arms have others."""


def check(owner: ObjectClass, name: str) -> None:
    """Refuse a variable that the object does not have.

    Raises:
        RefusedError: there is none of that name or number.
    """
    upper = name.strip().upper()
    if owner is ObjectClass.CONTROLLER and _NUMBERED.fullmatch(upper):
        return
    if (owner, upper) not in _READERS:
        raise RefusedError(OBJECT_NOT_FOUND)


def read(context: Context) -> Variant:
    """Read the variable of `context.object`."""
    place = _place(context.object)
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
    if place:
        context.machine.memory.write(*place, value)
        return DONE
    name = context.object.name.strip().upper()
    act = _ACTS.get((_owner(context.object), name))
    if act is not None:
        if context.machine.slave.mode is not None:
            context.machine.refuse(E_REFUSED_IN_SLAVE_MODE, context.now)
        return act(context, value)
    if name not in _SPEEDS or not 0 < number_of(value) <= 100:
        raise RefusedError(NOT_WRITABLE)
    setattr(context.machine.speeds, _SPEEDS[name], float(number_of(value)))
    return DONE


def names(owner: ObjectClass) -> tuple[str, ...]:
    """List the variables of an object, the numbered ones by their first."""
    numbered = tuple(f"{letter}0" for letter in LETTERS) if owner is ObjectClass.CONTROLLER else ()
    return (*numbered, *(name for kind, name in _READERS if kind is owner))


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


def _start_task(context: Context, value: Variant) -> Outcome:
    context.machine.start_task(_task_name(context))
    return DONE


def _stop_task(context: Context, value: Variant) -> Outcome:
    context.machine.stop_task(_task_name(context), context.now)
    return DONE


def _task_name(context: Context) -> str:
    task = context.object.parent
    return task.name if task else ""


_ACTS: Mapping[tuple[ObjectClass, str], Command] = MappingProxyType(
    {
        (ObjectClass.ROBOT, "@SERVO_ON"): motor,
        (ObjectClass.TASK, "@START"): _start_task,
        (ObjectClass.TASK, "@STOP"): _stop_task,
    }
)
"""Variables that do what a command does when they are written: Motor, Task_Start, Task_Stop."""


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
