"""Variables of controller, robot and task objects: their names, types and the effect of writing them.

Sources: ShoheiKobata/orin_bcap_python_samples and its documentation, DENSORobot/denso_robot_ros2, DENSO Wave
2009, How to use the Slave mode, and public robot code. The name of a numbered variable is a letter and a
number (`I5`), or a letter and `*` with the number in the option. Vector types are R4 arrays on RC7 and may be
R8 arrays on RC8.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bcapscope.protocol.codec.variant import Variant, integer_value
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import ObjectClass


@dataclass(frozen=True, slots=True)
class VariableKind:
    """A variable, or a family of numbered variables such as `I0`, `I1` and so on.

    Attributes:
        owner: Class of the object that has the variable.
        name: The vendor's name of the variable; for a family, without the number.
        is_numbered: Whether a number or `*` follows the name.
        types: Possible types of the value, such as `VT_R4|VT_ARRAY`; () if no source says.
        text: Meaning of the value, one clause.
    """

    owner: ObjectClass
    name: str
    is_numbered: bool
    types: tuple[str, ...]
    text: str


SERVO_ON, _START, _STOP = "@SERVO_ON", "@START", "@STOP"

_R4S, _R8S = "VT_R4|VT_ARRAY", "VT_R8|VT_ARRAY"
_CONTROLLER, _ROBOT, _TASK = ObjectClass.CONTROLLER, ObjectClass.ROBOT, ObjectClass.TASK

_NUMBERED: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("I", ("VT_I4",), "integer"),
    ("F", ("VT_R4",), "single-precision number"),
    ("D", ("VT_R8",), "double-precision number"),
    ("V", (_R4S, _R8S), "vector: X, Y, Z"),
    ("P", (_R4S, _R8S), "position: X, Y, Z [mm], Rx, Ry, Rz [deg], Fig"),
    ("J", (_R4S, _R8S), "joints: J1..J8 [deg]"),
    ("T", (_R4S, _R8S), "position: X, Y, Z [mm], Ox, Oy, Oz, Ax, Ay, Az, Fig"),
    ("S", ("VT_BSTR",), "text"),
    ("IO", ("VT_BOOL",), "I/O bit"),
    ("IOB", ("VT_UI1", "VT_I2"), "8 I/O bits"),
    ("IOW", ("VT_I2", "VT_I4"), "16 I/O bits"),
    ("IOD", ("VT_I4",), "32 I/O bits"),
    ("IOF", ("VT_R4",), "32 I/O bits as a number"),
    ("TOOL", (), "tool definition (RC7)"),
    ("WORK", (), "work definition (RC7)"),
)

# Owner, name, types, text. No source prints the types of @FIRMWARE to @AUTO_ENABLE, @TYPE, @CURRENT_TOOL and
# @CURRENT_WORK. Their types are inferred from the meaning.
_NAMED: tuple[tuple[ObjectClass, str, tuple[str, ...], str], ...] = (
    (_CONTROLLER, "@MODE", ("VT_I4",), "1 manual, 2 teach check, 3 automatic"),
    (_CONTROLLER, "@ERROR_CODE", ("VT_I4",), "code of the active error"),
    (_CONTROLLER, "@ERROR_DESCRIPTION", ("VT_BSTR",), "text of the active error"),
    (_CONTROLLER, "@VERSION", ("VT_BSTR",), "software version"),
    (_CONTROLLER, "@FIRMWARE", ("VT_BSTR",), "firmware version"),
    (_CONTROLLER, "@CURRENT_TIME", ("VT_DATE",), "controller's clock"),
    (_CONTROLLER, "@LOCK", ("VT_BOOL", "VT_I4"), "machine lock"),
    (_CONTROLLER, "@EMERGENCY_STOP", ("VT_BOOL", "VT_I4"), "emergency stop"),
    (_CONTROLLER, "@BUSY_STATUS", ("VT_BOOL", "VT_I4"), "a program is running"),
    (_CONTROLLER, "@IO_ALLOC_MODE", ("VT_BOOL", "VT_I4"), "allocation of I/O"),
    (_CONTROLLER, "@NORMAL_STATUS", ("VT_BOOL", "VT_I4"), "no error is active"),
    (_CONTROLLER, "@AUTO_ENABLE", ("VT_BOOL", "VT_I4"), "automatic enable"),
    (_CONTROLLER, "_ITP", (), "seen on RC7, meaning not known"),
    *((_CONTROLLER, f"@VAR_{x}_LEN", ("VT_I4",), f"number of {x} variables") for x in "IFDVPJTS"),
    (_ROBOT, "@CURRENT_POSITION", (_R8S, _R4S), "position now: X, Y, Z, Rx, Ry, Rz, Fig"),
    (_ROBOT, "@CURRENT_ANGLE", (_R8S, _R4S), "joints now: J1..J8"),
    (_ROBOT, "@HIGH_CURRENT_POSITION", (_R8S, _R4S), "position now, read faster"),
    (_ROBOT, "@HIGH_CURRENT_ANGLE", (_R8S, _R4S), "joints now, read faster"),
    (_ROBOT, SERVO_ON, ("VT_BOOL",), "motor on; writing TRUE switches it on, FALSE off"),
    (_ROBOT, "@BUSY_STATUS", ("VT_BOOL",), "robot moves"),
    (_ROBOT, "@SPEED", ("VT_R4",), "internal speed of the tool tip"),
    (_ROBOT, "@ACCEL", ("VT_R4",), "internal acceleration of the tool tip"),
    (_ROBOT, "@DECEL", ("VT_R4",), "internal deceleration of the tool tip"),
    (_ROBOT, "@JSPEED", ("VT_R4",), "internal speed of the joints"),
    (_ROBOT, "@JACCEL", ("VT_R4",), "internal acceleration of the joints"),
    (_ROBOT, "@JDECEL", ("VT_R4",), "internal deceleration of the joints"),
    (_ROBOT, "@EXTSPEED", ("VT_R4",), "external speed"),
    (_ROBOT, "@EXTACCEL", ("VT_R4",), "external acceleration"),
    (_ROBOT, "@EXTDECEL", ("VT_R4",), "external deceleration"),
    (_ROBOT, "@TYPE", ("VT_I4",), "number of the robot type; read it before the first motion"),
    (_ROBOT, "@TYPE_NAME", ("VT_BSTR",), "name of the robot type"),
    (_ROBOT, "@CURRENT_TOOL", ("VT_I4",), "tool number"),
    (_ROBOT, "@CURRENT_WORK", ("VT_I4",), "work number"),
    (_TASK, "@STATUS", ("VT_I4",), "state of the task"),
    (_TASK, _START, ("VT_I4",), "starts the task when written"),
    (_TASK, _STOP, ("VT_I4",), "stops the task when written"),
)

VARIABLES: tuple[VariableKind, ...] = (
    *(VariableKind(_CONTROLLER, name, True, types, text) for name, types, text in _NUMBERED),
    *(VariableKind(owner, name, False, types, text) for owner, name, types, text in _NAMED),
)
"""All known variables."""

_BY_KEY = {(kind.owner, kind.name.casefold(), kind.is_numbered): kind for kind in VARIABLES}
_NUMBERED_NAME = re.compile(r"([a-z]+)(?:[0-9]+|\*)")


def find_variable(owner: ObjectClass, name: str) -> VariableKind | None:
    """Return a variable by its object's class and its name, ignoring case; None if unknown."""
    folded = name.casefold()
    match = _NUMBERED_NAME.fullmatch(folded)
    if match:
        return _BY_KEY.get((owner, match[1], True))
    return _BY_KEY.get((owner, folded, False))


def write_effect(name: str, value: Variant) -> CallEffect:
    """Return the strongest effect that writing a variable can have.

    `name` may have any case; "" if unknown. A running program may wait for any variable. Therefore every
    write has the effect `MOVES`, except those to @SERVO_ON, which switches the motor, and @STOP, which stops
    a task.
    """
    folded = name.casefold()
    if folded == SERVO_ON.casefold():
        switches_off = value.value is False or integer_value(value) == 0
        return CallEffect.CHANGES if switches_off else CallEffect.ENERGISES
    return CallEffect.CHANGES if folded == _STOP.casefold() else CallEffect.MOVES
