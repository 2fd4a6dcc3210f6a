"""Reading the title of a column: which axis, commanded or measured, in which unit.

Known titles: those of `bcapscope extract`, and plain names of axes and joints. The titles of a controller's
log and their English forms are also known: `[J1 - 指令値]`, `[FIG - 指令値]`
(ShoheiKobata/orin_bcap_python_samples others/Get_Syslog.py and DrawLineDemo). A title with an unknown word is
ignored, so that a force or a distance is never read as a position.
"""

from __future__ import annotations

import re
import unicodedata
from enum import StrEnum
from typing import NamedTuple

from bcapscope.protocol.slave_mode.poses import AXES


class ColumnRole(StrEnum):
    """Role of the numbers in a column, in order of preference."""

    COMMANDED = "commanded"
    UNMARKED = "not marked as commanded or measured"
    MEASURED = "measured"


class Unit(NamedTuple):
    """A unit of an `angle`, a `length` or a `time`; the factor converts to degrees, mm or seconds."""

    name: str
    kind: str
    factor: float


UNITS = {
    unit.name: unit
    for unit in (
        Unit("deg", "angle", 1.0),
        Unit("rad", "angle", 57.29577951308232),
        Unit("mm", "length", 1.0),
        Unit("m", "length", 1000.0),
        Unit("s", "time", 1.0),
        Unit("ms", "time", 1e-3),
        Unit("us", "time", 1e-6),
    )
}
"""Known units by their names."""

TIME, COUNTER, NUMBER = "time", "counter", "number"
"""Names of the columns that hold the time, the controller's counter, or the number of the record."""


class ColumnTitle(NamedTuple):
    """Meaning of a title: axis, `TIME`, `COUNTER` or `NUMBER`; the column's role; its unit, if any."""

    axis: str
    role: ColumnRole
    unit: Unit | None


_AXIS = {axis.name.casefold(): axis.name for kind in AXES.values() for axis in kind}
_JOINT = re.compile(r"(?:j|joint|axis|軸|関節)([1-8])")
_COMMANDED = (
    *("指令値", "指令", "command", "commanded", "cmd"),
    *("reference", "ref", "target", "setpoint", "desired"),
)
_MEASURED = ("エンコーダ値", "エンコーダ", "encoder", "actual", "measured", "returned", "feedback", "現在値")
_ROLES = {
    **dict.fromkeys(_COMMANDED, ColumnRole.COMMANDED),
    **dict.fromkeys(_MEASURED, ColumnRole.MEASURED),
}
_UNIT_WORDS = {
    **UNITS,
    **dict.fromkeys(("degree", "degrees", "度", "°"), UNITS["deg"]),
    **dict.fromkeys(("radian", "radians"), UNITS["rad"]),
    **dict.fromkeys(("sec", "second", "seconds", "秒"), UNITS["s"]),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), UNITS["ms"]),
    **dict.fromkeys(("usec", "µs", "μs"), UNITS["us"]),
}
_OTHER_COLUMNS = {
    **dict.fromkeys(("time", "t", "時刻", "時間", "timestamp", "経過時間"), TIME),
    **dict.fromkeys(("counter", "コントローラ起動時からのカウンタ", "カウンタ"), COUNTER),
    **dict.fromkeys(("no", "number", "番号", "index"), NUMBER),
}
_FILLERS = frozenset(("value", "pos", "position", "angle", "値", "位置", "角度", "point"))
_WORD = re.compile(r"[a-z]+\d*|\d+|[°µμ]s?|[^\W\da-z_]+")
_LONGEST = 80


def read_title(text: str) -> ColumnTitle | None:
    """Read a title; return None if its column is no part of a trajectory."""
    words = _words(text)
    if "counter" in words:
        return ColumnTitle(COUNTER, ColumnRole.UNMARKED, None)
    axis: str | None = None
    role, unit = ColumnRole.UNMARKED, None
    for word in words:
        found = _axis_name(word)
        if found and axis is None:
            axis = found
        elif word in _ROLES:
            role = _ROLES[word]
        elif word in _UNIT_WORDS and unit is None:
            unit = _UNIT_WORDS[word]
        elif word not in _FILLERS:
            return None
    return None if axis is None else ColumnTitle(axis, role, unit)


def _words(text: str) -> list[str]:
    """Split a title between letters, digits and Japanese; join a number to a preceding word for joint."""
    plain = unicodedata.normalize("NFKC", text[:_LONGEST]).casefold()
    words: list[str] = []
    for word in _WORD.findall(plain.replace("_", " ")):
        joins = words and word.isdecimal() and words[-1] in ("j", "joint", "axis", "軸", "関節")
        words = [*words[:-1], words[-1] + word] if joins else [*words, word]
    return words


def _axis_name(word: str) -> str | None:
    joint = _JOINT.fullmatch(word)
    return f"J{joint[1]}" if joint else _AXIS.get(word) or _OTHER_COLUMNS.get(word)
