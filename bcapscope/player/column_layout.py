"""Find the columns of a trajectory in a table: by title, by number, or by the user's description.

The reader knows the titles that `bcapscope extract` writes, and the names of axes and joints. The reader also
knows the titles in a controller's log, in Japanese and in English, such as `[J1 - 指令値]` or
`[FIG - 指令値]`. These titles come from others/Get_Syslog.py and DrawLineDemo in
ShoheiKobata/orin_bcap_python_samples. The reader ignores a column with an unknown word in its title, so that
the reader never mistakes a force or a distance for a position.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise, takewhile
from typing import NamedTuple

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.player.trajectory import MIN_COLUMNS, Column, TrajectoryError
from bcapscope.protocol.slave_mode.modes import PoseType
from bcapscope.protocol.slave_mode.poses import AXES, Axis


class ColumnRole(StrEnum):
    """Whether numbers are commanded or measured. The reader tries the roles in this order."""

    COMMANDED = "commanded"
    UNMARKED = "not marked as commanded or measured"
    MEASURED = "measured"


class Unit(NamedTuple):
    """A unit of an `angle`, a `length` or a `time`. `factor` converts numbers to degrees, mm or seconds."""

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

TIME, COUNTER, NUMBER = "time", "counter", "number"
"""Names of the columns for the time, the controller's counter and the number of the record."""


class ColumnTitle(NamedTuple):
    """Meaning of a title: `axis` is an axis, `TIME`, `COUNTER` or `NUMBER`; `unit` may be None."""

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

_NAMES = {TIME: TIME, COUNTER: COUNTER, **_AXIS}
_PAIR = re.compile(r"\s*(\w+)(?:\.\.(\w+))?\s*=\s*([0-9]{1,4})(?:\.\.([0-9]{1,4}))?\s*")
_PREFERENCE = (PoseType.J, PoseType.P, PoseType.T)
_HALF_TURN = 180.0
_POSTURES = 31.0
_MAX_NAMED = 12
_EVEN = 1e-3  # maximum difference between the intervals of a time column, as a share of the first interval
_USUAL_AXES = 6


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """The user's description of a file with a trajectory.

    Attributes:
        kind: Pose type to read; None to choose a pose type that the file has, preferably joints.
        columns: Column numbers, counted from 1, for each axis and for `time`; empty to use the titles.
        angle: Unit of angles if the file names none: `deg` or `rad`.
        length: Unit of positions if the file names none: `mm` or `m`.
    """

    kind: PoseType | None = None
    columns: Mapping[str, int] = field(default_factory=dict)
    angle: str = "deg"
    length: str = "mm"


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """The columns of a trajectory, one per axis, in order. `notes` say what the reader chose or assumed."""

    kind: PoseType
    columns: tuple[Column, ...]
    time: Column | None = None
    counter: Column | None = None
    notes: tuple[Message, ...] = ()


def parse_columns(text: str) -> dict[str, int]:
    """Parse a description such as `time=1,J1..J6=2..7`, with the columns counted from 1."""
    columns: dict[str, int] = {}
    for part in text.split(","):
        for name, place in _column_pairs(part):
            if name in columns:
                raise InputError(Message("columns.twice", name=name))
            columns[name] = place
    return columns


def _column_pairs(part: str) -> Iterator[tuple[str, int]]:
    found, text = _PAIR.fullmatch(part), repr(part.strip())
    if not found:
        raise InputError(Message("columns.invalid", text=text))
    first, last = found[1].casefold(), (found[2] or found[1]).casefold()
    order = list(_NAMES)
    if first not in order or last not in order:
        raise InputError(Message("columns.no-name", text=text, names=", ".join(_NAMES.values())))
    names = order[order.index(first) : order.index(last) + 1]
    if not names:
        raise InputError(Message("columns.order", text=text, last=found[2], first=found[1]))
    begin, end = int(found[3]), int(found[4] or found[3])
    if not 0 < begin <= end:
        raise InputError(Message("columns.from-one", text=text))
    count = end - begin + 1
    if count != len(names):
        raise InputError(Message("columns.count", text=text, names=len(names), columns=count))
    yield from zip((_NAMES[name] for name in names), range(begin, end + 1), strict=True)


def layout_of_titles(titles: Sequence[str], options: ReadOptions) -> ColumnLayout | None:
    """Find the columns by their titles; return None if the columns are too few for any pose type."""
    if options.columns:
        return _layout_as_given(options, titles, len(titles))
    read = [read_title(title) for title in titles]
    for role in ColumnRole:
        places = _axis_places(read, role)
        found = {kind: axes for kind in _PREFERENCE if (axes := _leading_axes(kind, places))}
        if len(found.get(PoseType.J, ())) < sum(name[0] == "J" for name in places):
            found.pop(PoseType.J, None)  # a joint has no column, but a later joint has one
        kind = next((kind for kind in found if options.kind in (None, kind)), None)
        if kind is not None:
            others = [other for other in found if other is not kind]
            return ColumnLayout(
                kind=kind,
                columns=tuple(_column(axis, places[axis.name], titles, options) for axis in found[kind]),
                time=_extra_column(TIME, titles, read),
                counter=_extra_column(COUNTER, titles, read) or _extra_column(NUMBER, titles, read),
                notes=tuple(_layout_notes(kind, others, found[kind], role, read)),
            )
    return None


def layout_of_numbers(rows: Sequence[Sequence[float]], options: ReadOptions) -> ColumnLayout:
    """Guess what columns without titles mean; raise TrajectoryError if the meaning is unclear."""
    count = len(rows[0])
    if options.columns:
        return _layout_as_given(options, (), count)
    advice = Message("trajectory.advice.columns")
    kind = options.kind or (PoseType.J if 6 <= count <= 8 else None)
    if kind is None or not max(MIN_COLUMNS[kind], 6) <= count <= len(AXES[kind]):
        size = Message("trajectory.six-to-eight")
        if kind:
            size = Message("trajectory.numbers-a-line", count=len(AXES[kind]))
        raise TrajectoryError(Message("trajectory.untitled-width", count=count, size=size, advice=advice), 1)
    doubt = _ambiguity(rows) if options.kind is None else None
    if doubt:
        raise TrajectoryError(
            Message("trajectory.untitled-doubt", count=count, doubt=doubt, advice=advice), 1
        )
    columns = tuple(_column(axis, place, (), options) for place, axis in enumerate(AXES[kind][:count], 1))
    note = Message("trajectory.note.untitled", count=count, first=columns[0].axis, last=columns[-1].axis)
    return ColumnLayout(kind, columns, notes=(note,))


def _ambiguity(rows: Sequence[Sequence[float]]) -> Message | None:
    """Return why the numbers are probably not joint angles; None if they are probably joint angles."""
    first = [row[0] for row in rows]
    steps = [b - a for a, b in pairwise(first)]
    if len(steps) > 1 and steps[0] > 0 and max(steps) - min(steps) <= _EVEN * steps[0]:
        begins = first[0] == 0 or abs(first[0] - steps[0]) <= _EVEN * steps[0]
        if begins or len(rows[0]) > _USUAL_AXES:
            return Message("trajectory.doubt.time")
    if len(rows[0]) != 7:
        return None
    far = any(abs(value) > _HALF_TURN for row in rows for value in row[:3])
    posture = all(row[6] == rows[0][6] and row[6].is_integer() and abs(row[6]) <= _POSTURES for row in rows)
    return Message("trajectory.doubt.position") if far and posture else None


def _axis_places(read: Sequence[ColumnTitle | None], role: ColumnRole) -> dict[str, int]:
    places: dict[str, int] = {}
    for place, title in enumerate(read, 1):
        if title and title.role is role:
            places.setdefault(title.axis, place)
    return places


def _leading_axes(kind: PoseType, places: Mapping[str, int]) -> tuple[Axis, ...]:
    """Return the axes from the first axis up to the first axis without a column. Return () if these are fewer
    than `MIN_COLUMNS`.
    """
    axes = tuple(takewhile(lambda axis: axis.name in places, AXES[kind]))
    return axes if len(axes) >= MIN_COLUMNS[kind] else ()


def _column(axis: Axis, place: int, titles: Sequence[str], options: ReadOptions) -> Column:
    name = titles[place - 1] if titles else ""
    if not axis.unit:
        return Column(axis.name, place, name)
    title = read_title(name)
    unit = title.unit if title else None
    if unit is None or unit.kind == "time":
        unit = UNITS[options.angle if axis.unit == "deg" else options.length]
    return Column(axis.name, place, name, unit.name, unit.factor)


def _extra_column(name: str, titles: Sequence[str], read: Sequence[ColumnTitle | None]) -> Column | None:
    for place, title in enumerate(read):
        if title and title.axis == name and title.role is not ColumnRole.MEASURED:
            unit = title.unit or UNITS["s"]
            scale = (unit.name, unit.factor) if name == TIME else ()
            return Column(name, place + 1, titles[place], *scale)
    return None


def _layout_as_given(options: ReadOptions, titles: Sequence[str], count: int) -> ColumnLayout:
    missing = [f"{name}={place}" for name, place in options.columns.items() if place > count]
    if missing:
        reason = Message("trajectory.missing-columns", count=count, missing=", ".join(missing))
        raise TrajectoryError(reason, 1)
    wanted = [kind for kind in _PREFERENCE if options.kind in (None, kind)]
    kind = next((kind for kind in wanted if _leading_axes(kind, options.columns)), None)
    if kind is None:
        raise TrajectoryError(Message("trajectory.columns-no-pose"), 1)
    axes = _leading_axes(kind, options.columns)
    first, last = axes[0].name, axes[-1].name
    spare = [name for name in options.columns if name not in (TIME, COUNTER, *(axis.name for axis in axes))]
    if spare:
        reason = Message("trajectory.spare-columns", spare=", ".join(spare), first=first, last=last)
        raise TrajectoryError(reason, 1)

    def other(name: str, unit: str) -> Column | None:
        place = options.columns.get(name)
        title = titles[place - 1] if titles and place else ""
        return Column(name, place, title, unit) if place else None

    columns = tuple(_column(axis, options.columns[axis.name], titles, options) for axis in axes)
    return ColumnLayout(kind, columns, other(TIME, "s"), other(COUNTER, ""))


def _layout_notes(
    kind: PoseType,
    others: Sequence[PoseType],
    axes: Sequence[Axis],
    role: ColumnRole,
    read: Sequence[ColumnTitle | None],
) -> Iterator[Message]:
    if role is ColumnRole.MEASURED:
        yield Message("trajectory.note.measured")
    elif role is ColumnRole.UNMARKED and any(title and title.role is ColumnRole.COMMANDED for title in read):
        yield Message("trajectory.note.unmarked")
    if others:
        yield Message("trajectory.note.kind", kind=str(kind), others=" and ".join(others))
    for axis in axes:
        places = [
            str(place)
            for place, title in enumerate(read, 1)
            if title and title.role is role and title.axis == axis.name
        ]
        if len(places) > 1:
            yield Message("trajectory.note.duplicate", axis=axis.name, columns=", ".join(places))


def list_titles(titles: Sequence[str]) -> Message:
    named = ", ".join(" ".join(title[:40].split()) for title in titles[:_MAX_NAMED])
    more = len(titles) - _MAX_NAMED
    return Message("list.and-more", items=named, more=more) if more > 0 else Message.from_table("text", named)


def read_title(text: str) -> ColumnTitle | None:
    """Read the title of a column; return None if the column does not belong to a trajectory."""
    words = _words(text)
    if "counter" in words:
        return ColumnTitle(COUNTER, ColumnRole.UNMARKED, None)
    axis: str | None = None
    role, unit = ColumnRole.UNMARKED, None
    for word in words:
        joint = _JOINT.fullmatch(word)
        found = f"J{joint[1]}" if joint else _AXIS.get(word) or _OTHER_COLUMNS.get(word)
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
    """Split a title into letters, digits and Japanese characters, but keep joint and number together."""
    plain = unicodedata.normalize("NFKC", text[:_LONGEST]).casefold()
    words: list[str] = []
    for word in _WORD.findall(plain.replace("_", " ")):
        joins = words and word.isdecimal() and words[-1] in ("j", "joint", "axis", "軸", "関節")
        words = [*words[:-1], words[-1] + word] if joins else [*words, word]
    return words
