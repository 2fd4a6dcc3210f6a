"""Which columns of a table make a trajectory, by their titles, by their number, or as the user says."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from bcapscope.player.titles import COUNTER, NUMBER, TIME, UNITS, Role, Title, Unit, read_title
from bcapscope.player.trajectory import FEWEST, Column, TrajectoryError
from bcapscope.protocol.poses import AXES, Axis
from bcapscope.protocol.slavemode import PoseType

_NAMES = {
    name.casefold(): name for name in (TIME, COUNTER, *(axis.name for kind in AXES.values() for axis in kind))
}
_PAIR = re.compile(r"\s*(\w+)(?:\.\.(\w+))?\s*=\s*([0-9]{1,4})(?:\.\.([0-9]{1,4}))?\s*")
_PREFERENCE = (PoseType.J, PoseType.P, PoseType.T)
_HALF_TURN = 180.0
_POSTURES = 31.0
_MOST_NAMED = 12
_EVEN = 1e-3  # share by which steps may differ and still count as even
_USUAL_AXES = 6


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the user says of a file.

    Attributes:
        kind: pose type; None to take what there is, joints first.
        columns: column of each axis and of `time`, counted from 1; empty to go by titles.
        angle: unit of angles where the file does not say: `deg` or `rad`.
        length: unit of positions likewise: `mm` or `m`.
    """

    kind: PoseType | None = None
    columns: Mapping[str, int] = field(default_factory=dict)
    angle: str = "deg"
    length: str = "mm"


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns make a trajectory.

    Attributes:
        kind: pose type.
        columns: an element an axis, in order.
        time: column of the times; None where there is none.
        counter: column that counts records or time; None likewise.
        notes: what was chosen or assumed, a clause each.
    """

    kind: PoseType
    columns: tuple[Column, ...]
    time: Column | None = None
    counter: Column | None = None
    notes: tuple[str, ...] = ()


def parse_columns(text: str) -> dict[str, int]:
    """Read a description such as `time=1,J1..J6=2..7`: which column, counted from 1, each axis is in.

    Raises:
        ValueError: it makes no sense.
    """
    columns: dict[str, int] = {}
    for part in text.split(","):
        for name, place in _pairs(part):
            if name in columns:
                raise ValueError(f"{name} is told twice")
            columns[name] = place
    return columns


def _pairs(part: str) -> Iterator[tuple[str, int]]:
    found = _PAIR.fullmatch(part)
    if not found:
        raise ValueError(f"{part.strip()!r} tells no column; time=1,J1..J6=2..7 does")
    first, last = found[1].casefold(), (found[2] or found[1]).casefold()
    order = list(_NAMES)
    if first not in order or last not in order:
        raise ValueError(f"{part.strip()!r}: names are {', '.join(_NAMES.values())}")
    names = order[order.index(first) : order.index(last) + 1]
    if not names:
        raise ValueError(f"{part.strip()!r}: {found[2]} does not come after {found[1]}")
    begin, end = int(found[3]), int(found[4] or found[3])
    if not 0 < begin <= end:
        raise ValueError(f"{part.strip()!r}: columns are counted from 1, and upwards")
    if end - begin + 1 != len(names):
        raise ValueError(f"{part.strip()!r}: {len(names)} names for {end - begin + 1} columns")
    yield from zip((_NAMES[name] for name in names), range(begin, end + 1), strict=True)


def layout_of_titles(titles: Sequence[str], wishes: Wishes) -> Layout | None:
    """Find the columns by their titles; None where no pose is whole.

    Raises:
        TrajectoryError: columns that the user told are not there.
    """
    if wishes.columns:
        return _layout_as_told(wishes, titles, len(titles))
    read = [read_title(title) for title in titles]
    for role in Role:
        found = {kind: _of_kind(kind, role, read) for kind in _PREFERENCE}
        whole = [kind for kind, places in found.items() if places and wishes.kind in (None, kind)]
        if whole:
            kind, places = whole[0], found[whole[0]]
            others = [other for other, seen in found.items() if seen and other is not kind]
            return Layout(
                kind=kind,
                columns=tuple(
                    _column(axis, place, titles[place], read[place], wishes)
                    for axis, place in zip(AXES[kind], places, strict=False)
                ),
                time=_other(TIME, titles, read, wishes),
                counter=_other(COUNTER, titles, read, wishes) or _other(NUMBER, titles, read, wishes),
                notes=(
                    *_role_notes(role, read),
                    *_kind_notes(kind, others),
                    *_doublet_notes(AXES[kind][: len(places)], role, read),
                ),
            )
    return None


def layout_of_numbers(rows: Sequence[Sequence[float]], wishes: Wishes) -> Layout:
    """Guess what bare numbers are.

    Args:
        rows: the first lines, at least one.
        wishes: what the user says.

    Raises:
        TrajectoryError: they may be several things, or none.
    """
    count = len(rows[0])
    if wishes.columns:
        return _layout_as_told(wishes, (), count)
    advice = "tell the columns, such as time=1,J1..J6=2..7"
    kind = wishes.kind or (PoseType.J if 6 <= count <= 8 else None)
    if kind is None or not max(FEWEST[kind], 6) <= count <= len(AXES[kind]):
        size = f"{len(AXES[kind])} numbers a line" if kind else "6 to 8 numbers a line"
        raise TrajectoryError(f"{count} numbers a line and no titles, where {size} are expected: {advice}", 1)
    if wishes.kind is None:
        doubt = _doubt(rows)
        if doubt:
            raise TrajectoryError(f"{count} numbers a line without titles, {doubt}: {advice}, or the type", 1)
    columns = tuple(
        Column(axis.name, place, "", *_unit(axis, None, wishes))
        for place, axis in enumerate(AXES[kind][:count], 1)
    )
    note = f"no titles: {count} numbers a line are taken as {columns[0].axis} to {columns[-1].axis}"
    return Layout(kind, columns, notes=(note,))


def _doubt(rows: Sequence[Sequence[float]]) -> str:
    """Say why numbers may be no joints; empty where they look like joints."""
    first = [row[0] for row in rows]
    steps = [b - a for a, b in pairwise(first)]
    if len(steps) > 1 and steps[0] > 0 and max(steps) - min(steps) <= _EVEN * steps[0]:
        begins = first[0] == 0 or abs(first[0] - steps[0]) <= _EVEN * steps[0]
        if begins or len(rows[0]) > _USUAL_AXES:
            return "the first of which may be a time or count the records"
    if len(rows[0]) != 7:
        return ""
    far = any(abs(value) > _HALF_TURN for row in rows for value in row[:3])
    posture = all(row[6] == rows[0][6] and row[6].is_integer() and abs(row[6]) <= _POSTURES for row in rows)
    return "which may be X to Fig" if far and posture else ""


def _of_kind(kind: PoseType, role: Role, read: Sequence[Title | None]) -> list[int]:
    """Return the place of each axis of a kind as far as the row has no hole; () where it is too short."""
    by_name: dict[str, int] = {}
    for place, title in enumerate(read):
        if title and title.role is role:
            by_name.setdefault(title.axis, place)
    places: list[int] = []
    for axis in AXES[kind]:
        if axis.name not in by_name:
            break
        places.append(by_name[axis.name])
    complete = kind is not PoseType.J or len(places) == sum(name[0] == "J" for name in by_name)
    return places if len(places) >= FEWEST[kind] and complete else []


def _column(axis: Axis, place: int, name: str, title: Title | None, wishes: Wishes) -> Column:
    return Column(axis.name, place + 1, name, *_unit(axis, title.unit if title else None, wishes))


def _unit(axis: Axis, told: Unit | None, wishes: Wishes) -> tuple[str, float]:
    """Return the unit that a column counts in and the factor to that of the axis."""
    if not axis.unit:
        return "", 1.0
    unit = UNITS[wishes.angle if axis.unit == "deg" else wishes.length]
    if told is not None and told.kind != "time":
        unit = told
    return unit.name, unit.factor


def _other(name: str, titles: Sequence[str], read: Sequence[Title | None], wishes: Wishes) -> Column | None:
    for place, title in enumerate(read):
        if title and title.axis == name and title.role is not Role.MEASURED:
            unit = (title.unit or UNITS["s"]) if name == TIME else None
            return Column(name, place + 1, titles[place], *((unit.name, unit.factor) if unit else ("", 1.0)))
    return None


def _layout_as_told(wishes: Wishes, titles: Sequence[str], count: int) -> Layout:
    missing = [f"{name}={place}" for name, place in wishes.columns.items() if place > count]
    if missing:
        raise TrajectoryError(f"there are {count} columns, so that there is none for {', '.join(missing)}", 1)
    kinds = [kind for kind in _PREFERENCE if wishes.kind in (None, kind) and _told(kind, wishes.columns)]
    if not kinds:
        raise TrajectoryError(
            "the columns that were told are no whole pose: J1 on, X to Rz, or X to Az are", 1
        )
    axes = AXES[kinds[0]][: _told(kinds[0], wishes.columns)]
    spare = [name for name in wishes.columns if name not in (TIME, COUNTER, *(axis.name for axis in axes))]
    if spare:
        raise TrajectoryError(f"{', '.join(spare)} do not belong to {axes[0].name} to {axes[-1].name}", 1)

    def column(axis: Axis) -> Column:
        place = wishes.columns[axis.name] - 1
        name = titles[place] if titles else ""
        return _column(axis, place, name, read_title(name), wishes)

    def other(name: str, unit: str) -> Column | None:
        place = wishes.columns.get(name)
        title = titles[place - 1] if titles and place else ""
        return Column(name, place, title, unit) if place else None

    return Layout(kinds[0], tuple(map(column, axes)), other(TIME, "s"), other(COUNTER, ""))


def _told(kind: PoseType, columns: Mapping[str, int]) -> int:
    """Return how many axes of a kind are told without a hole; 0 where these are too few."""
    count = next(
        (place for place, axis in enumerate(AXES[kind]) if axis.name not in columns), len(AXES[kind])
    )
    return count if count >= FEWEST[kind] else 0


def _role_notes(role: Role, read: Sequence[Title | None]) -> Iterator[str]:
    marked = any(title and title.role is Role.COMMANDED for title in read)
    if role is Role.MEASURED:
        yield "these are measured values: there are no commanded ones"
    elif role is Role.UNMARKED and marked:
        yield "these values are not marked as commanded, and may be measured"


def _kind_notes(kind: PoseType, others: Sequence[PoseType]) -> Iterator[str]:
    if others:
        yield f"type {kind} was chosen; type {' and '.join(others)} is there too"


def _doublet_notes(axes: Sequence[Axis], role: Role, read: Sequence[Title | None]) -> Iterator[str]:
    """Tell of axes that several columns are for, of which the first is taken."""
    for axis in axes:
        places = [
            str(place)
            for place, title in enumerate(read, 1)
            if title and title.role is role and title.axis == axis.name
        ]
        if len(places) > 1:
            yield f"{axis.name} is in columns {', '.join(places)}, the first of which is taken"


def titles_text(titles: Sequence[str]) -> str:
    """List titles, the first few."""
    more = f" and {len(titles) - _MOST_NAMED} more" if len(titles) > _MOST_NAMED else ""
    return ", ".join(" ".join(title[:40].split()) for title in titles[:_MOST_NAMED]) + more
