"""Tables as text: CSV, TSV and numbers separated by spaces, with or without titles."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice

import numpy as np

from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.player import set_point_timing
from bcapscope.player.column_layout import (
    ColumnLayout,
    ReadOptions,
    layout_of_numbers,
    layout_of_titles,
    list_titles,
)
from bcapscope.player.column_titles import COUNTER
from bcapscope.player.set_point_timing import SetPointTiming
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import (
    MAX_POINTS,
    MIN_COLUMNS,
    Column,
    Trajectory,
    TrajectoryError,
    TrajectorySource,
)
from bcapscope.protocol.slave_mode.modes import PoseType

HEAD_LINES = 32
"""Lines to search for the titles."""

_PLAIN_CELLS = 60
_SPACES = re.compile(r"\s+")
_RETURNED = "returned_"
_NUMBER = re.compile(
    r"\s*[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?\s*|\s*[+-]?(nan|inf|infinity)\s*", re.IGNORECASE
)


class TableLine:
    """One line of a table, neither empty nor a comment; numbers count from 1."""

    __slots__ = ("cells", "number")

    def __init__(self, number: int, cells: list[str]) -> None:
        self.number = number
        self.cells = cells


def read_table(
    lines: Iterable[str], source: TrajectorySource, options: ReadOptions
) -> tuple[Trajectory, ...]:
    """Read a table; `source.file_format` holds its encoding.

    Returns one trajectory, or one per run of records if some are missing between them.

    Raises:
        TrajectoryError: The table holds no set points.
    """
    text = iter(lines)
    head = list(islice(text, HEAD_LINES))
    separator = _separator(head)
    rows = _table_lines(chain(head, text), separator)
    first = list(islice(rows, HEAD_LINES))
    if not first:
        raise TrajectoryError(Message("trajectory.empty"))
    layout, skipped, titles = _find_layout(first, options)
    width = len(first[skipped - 1].cells) if titles else len(first[0].cells)
    numbers = _NumberTable(layout, width, separator == ";")
    numbers.read_lines(chain(first[skipped:], rows))
    columns = _without_empty(layout.columns, layout.kind, numbers.filled)
    notes = [*source.notes, *layout.notes]
    if skipped > 1:
        notes.append(Message("trajectory.note.skipped", lines=Count(skipped - 1, "line")))
    if len(columns) < len(layout.columns):
        notes.append(Message("trajectory.note.empty-axes", axis=layout.columns[len(columns)].axis))
    sent = any(title.startswith(_RETURNED) for title in titles)
    logged = layout.counter is not None and layout.counter.axis == COUNTER
    form = (
        "trajectory.format.extract"
        if sent
        else "trajectory.format.log"
        if logged
        else "trajectory.format.table"
    )
    extra = [
        column
        for column in (layout.time, layout.counter)
        if column and numbers.column_values(column) is not None
    ]
    whole = replace(
        source,
        file_format=Message(form, encoding=source.file_format or ""),
        columns=(*columns, *extra),
        notes=tuple(notes),
    )
    return tuple(_split_parts(numbers, len(columns), layout, whole, sent))


def _separator(head: Sequence[str]) -> str:
    """Return the separator in half of the lines or more: tab, semicolon or comma; else a space."""
    lines = [line for line in head if line.strip() and not line.lstrip().startswith("#")]
    for mark in "\t;,":
        if lines and 2 * sum(mark in line for line in lines) >= len(lines):
            return mark
    return " "


def _table_lines(lines: Iterable[str], separator: str) -> Iterator[TableLine]:
    """Yield the lines that hold cells."""
    if separator == " ":
        for number, text in enumerate(lines, 1):
            plain = text.strip()
            if plain and not plain.startswith("#"):
                yield TableLine(number, _SPACES.split(plain))
        return
    reader = csv.reader(lines, delimiter=separator)
    try:
        for cells in reader:
            if any(cells) and not cells[0].lstrip().startswith("#"):
                yield TableLine(reader.line_num, cells)
    except csv.Error as error:
        raise TrajectoryError(Message("trajectory.no-table", reason=str(error)), reader.line_num) from None


def _find_layout(first: Sequence[TableLine], options: ReadOptions) -> tuple[ColumnLayout, int, Sequence[str]]:
    """Return the layout, the number of lines before the numbers, and the titles; () if there are none."""
    if _is_numeric(first[0]):
        bare = [[_lenient_float(cell) for cell in line.cells if cell.strip()] for line in first]
        even = [row for row in bare if len(row) == len(bare[0])]
        return layout_of_numbers(even, options), 0, ()
    for place, line in enumerate(first):
        if not _is_numeric(line):
            layout = layout_of_titles(line.cells, options)
            if layout is not None:
                return layout, place + 1, line.cells
    wanted = (
        Message("trajectory.wanted.kind", kind=str(options.kind))
        if options.kind
        else Message("trajectory.wanted.any")
    )
    found = list_titles([cell.strip() for cell in first[0].cells])
    raise TrajectoryError(Message("trajectory.no-columns", wanted=wanted, titles=found), first[0].number)


def _is_numeric(line: TableLine) -> bool:
    return all(_NUMBER.fullmatch(cell) for cell in line.cells if cell.strip())


def _lenient_float(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return float("nan")


class _NumberTable:
    """Collects the numbers of the layout's columns."""

    def __init__(self, layout: ColumnLayout, width: int, decimal_comma: bool) -> None:
        self._others = [column for column in (layout.time, layout.counter) if column is not None]
        self._columns = [*layout.columns, *self._others]
        self._width = width
        self._decimal_comma = decimal_comma
        self._table = np.empty((0, len(self._columns)))
        self._filled = [False] * len(self._columns)
        self._axes = len(layout.columns)

    @property
    def points(self) -> Array:
        return self._table[:, : self._axes]

    @property
    def filled(self) -> Sequence[bool]:
        return self._filled[: self._axes]

    def column_values(self, column: Column | None) -> Array | None:
        """Return the numbers of the time or the counter; None if there are none."""
        if column is None:
            return None
        place = self._axes + self._others.index(column)
        return self._table[:, place] if self._filled[place] else None

    def read_lines(self, lines: Iterable[TableLine]) -> None:
        """Read all lines.

        Raises TrajectoryError if a cell is no number, if a column is empty in only some lines, or if a line
        has another number of cells.
        """
        numbers, count = array("d"), 0
        for line in lines:
            numbers.extend(self._parse_row(line, count == 0))
            count += 1
            if count > MAX_POINTS:
                raise TrajectoryError(Message("trajectory.too-long", limit=MAX_POINTS), line.number)
        if not count:
            raise TrajectoryError(Message("trajectory.only-titles"))
        self._table = np.frombuffer(numbers, dtype=np.float64).reshape(count, len(self._columns)).copy()

    def _parse_row(self, line: TableLine, first: bool) -> Iterator[float]:
        cells = self._cells(line)
        for place, column in enumerate(self._columns):
            cell = cells[column.position - 1]
            full = bool(cell) and not cell.isspace()
            if first:
                self._filled[place] = full
            elif full is not self._filled[place]:
                case = "trajectory.filled-later" if full else "trajectory.filled-before"
                raise TrajectoryError(Message(case, axis=column.axis), line.number, column.position)
            yield self._parse_number(cell, line.number, column) * column.factor if full else float("nan")

    def _parse_number(self, cell: str, line: int, column: Column) -> float:
        text = cell.replace(",", ".") if self._decimal_comma else cell
        try:
            if "_" not in text:
                return float(text)
        except ValueError:
            pass
        shown = text.strip()[:_PLAIN_CELLS]
        raise TrajectoryError(
            Message("trajectory.no-number", value=f"{shown!r}", axis=column.axis), line, column.position
        )

    def _cells(self, line: TableLine) -> list[str]:
        cells = line.cells
        if len(cells) != self._width and len(cells) > self._width and not any(cells[self._width :]):
            return cells[: self._width]
        if len(cells) != self._width:
            raise TrajectoryError(
                Message("trajectory.other-width", columns=Count(len(cells), "column"), width=self._width),
                line.number,
            )
        return cells


def _without_empty(columns: tuple[Column, ...], kind: PoseType, filled: Sequence[bool]) -> tuple[Column, ...]:
    """Return the columns before the first empty one; raise if they are no pose or a later one has numbers."""
    width = next((place for place, full in enumerate(filled) if not full), len(filled))
    if any(filled[width:]) or width < MIN_COLUMNS[kind]:
        raise TrajectoryError(
            Message("trajectory.empty-column", axis=columns[width].axis), None, columns[width].position
        )
    return columns[:width]


def _split_parts(
    numbers: _NumberTable, width: int, layout: ColumnLayout, source: TrajectorySource, sent: bool
) -> Iterator[Trajectory]:
    points = numbers.points[:, :width]
    times, counter = numbers.column_values(layout.time), numbers.column_values(layout.counter)
    if times is not None:
        found = (
            set_point_timing.timing_from_send_times(times)
            if sent
            else set_point_timing.timing_from_due_times(times)
        )
        yield _make_trajectory(layout.kind, points, source, found)
        return
    if counter is None:
        yield _make_trajectory(layout.kind, points, source, SetPointTiming(None, None))
        return
    runs, step = set_point_timing.find_runs(counter)
    found = _counter_timing(layout.counter, step)
    for start, stop in runs:
        part = Message("trajectory.part.records", first=start + 1, last=stop) if len(runs) > 1 else None
        notes = (Message("trajectory.note.counter-jumps"),) if part else ()
        piece = replace(source, part=part, notes=source.notes + notes)
        yield _make_trajectory(layout.kind, points[start:stop].copy(), piece, found)


def _counter_timing(column: Column | None, step: float | None) -> SetPointTiming:
    """Derive the interval from the growth of the counter; no paper says what the counter counts."""
    if column is None or column.axis != COUNTER or step is None:
        return SetPointTiming(None, None)
    if step <= 1:
        return SetPointTiming(None, None, (Message("trajectory.note.counts-records"),))
    unit, period = ("ms", step / 1e3) if step < 1000 else ("µs", step / 1e6)
    return SetPointTiming(
        period, None, (Message("trajectory.note.counter-grows", step=f"{step:g}", unit=unit),)
    )


def _make_trajectory(
    kind: PoseType, points: Array, source: TrajectorySource, found: SetPointTiming
) -> Trajectory:
    source = replace(source, notes=(*source.notes, *found.notes))
    return Trajectory(kind, points, source, found.period, found.times)
