"""Variables of controller, robot and task objects (`variables.tsv`), and the effect of writing them.

The name of a numbered variable is a letter and a number (`I5`). The name may also be a letter and `*`; the
option string then holds the number of the variable.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bcapscope.protocol.codec.variant import Variant, integer_value
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.table_rows import table_rows


@dataclass(frozen=True, slots=True)
class VariableKind:
    """A variable, or a family of numbered variables such as `I0`, `I1` and so on.

    Attributes:
        name: DENSO's name of the variable; for a family, without the number or `*` that clients append.
        types: Possible types of the value, such as `VT_R4|VT_ARRAY`; () if no source says.
    """

    owner: ObjectClass
    name: str
    is_numbered: bool
    types: tuple[str, ...]
    text: str


SERVO_ON, _STOP = "@SERVO_ON", "@STOP"


def _variable(row: dict[str, str]) -> VariableKind:
    types = tuple(f"VT_{word.replace('[]', '|VT_ARRAY')}" for word in row["types"].split())
    name = row["name"]
    return VariableKind(ObjectClass(row["owner"]), name.rstrip("*"), name.endswith("*"), types, row["text"])


VARIABLES = tuple(_variable(row) for row in table_rows("variables"))

_BY_KEY = {(kind.owner, kind.name.casefold(), kind.is_numbered): kind for kind in VARIABLES}
_NUMBERED_NAME = re.compile(r"([a-z]+)(?:[0-9]+|\*)")


def find_variable(owner: ObjectClass, name: str) -> VariableKind | None:
    """Find a variable, ignoring case; return None if it is unknown."""
    folded = name.casefold()
    match = _NUMBERED_NAME.fullmatch(folded)
    if match:
        return _BY_KEY.get((owner, match[1], True))
    return _BY_KEY.get((owner, folded, False))


def write_effect(name: str, value: Variant) -> CallEffect:
    """Return the strongest effect that writing a variable can have. If the variable is unknown, `name` is "".

    A program on the controller may wait for any variable and then move the robot, so a write has the effect
    `MOVES`. There are two exceptions, with an effect weaker than `MOVES`: writing @SERVO_ON switches the
    motor, and writing @STOP stops a task.
    """
    folded = name.casefold()
    if folded == SERVO_ON.casefold():
        switches_off = value.value is False or integer_value(value) == 0
        return CallEffect.CHANGES if switches_off else CallEffect.ENERGISES
    return CallEffect.CHANGES if folded == _STOP.casefold() else CallEffect.MOVES
