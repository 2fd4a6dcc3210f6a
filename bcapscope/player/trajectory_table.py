"""Trajectories from tables: CSV, TSV and numbers separated by spaces, with or without titles."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.player.column_layout import (
    COUNTER,
    ColumnLayout,
    ReadOptions,
    layout_of_numbers,
    layout_of_titles,
    list_titles,
)
from bcapscope.player.smooth_curve import Array
from bcapscope.player.trajectory import (
    MAX_POINTS,
    MIN_COLUMNS,
    Column,
    SetPointTiming,
    Trajectory,
    TrajectoryError,
    TrajectorySource,
    find_runs,
    float_or_nan,
    timing_from_due_times,
    timing_from_send_times,
)
from bcapscope.protocol.slave_mode.modes import PoseType

HEAD_LINES = 32
"""The reader looks for the titles in this many lines at the start of the file."""

_PLAIN_CELLS = 60
_RETURNED = "returned_"
_NUMBER = re.compile(
    r"\s*[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?\s*|\s*[+-]?(nan|inf|infinity)\s*", re.IGNORECASE
)


class TableLine(NamedTuple):
    """A line of a table that is neither empty nor a comment; line numbers count from 1."""

    number: int
    cells: list[str]


def read_table(
    lines: Iterable[str], source: TrajectorySource, options: ReadOptions
) -> tuple[Trajectory, ...]:
    """Read a table; `source.file_format` holds the encoding. Raise TrajectoryError if the table has no set
    points.

    If records are missing, return one trajectory for each run of records without gaps.
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
    others = [column for column in (layout.time, layout.counter) if column]
    numbers, filled = _read_numbers(
        chain(first[skipped:], rows), [*layout.columns, *others], width, separator == ";"
    )
    columns = _without_empty(layout, filled)
    extra = {
        column: numbers[:, place] for place, column in enumerate(others, len(layout.columns)) if filled[place]
    }
    notes = [*source.notes, *layout.notes]
    if skipped > 1:
        notes.append(Message("trajectory.note.skipped", lines=Count(skipped - 1, "line")))
    if len(columns) < len(layout.columns):
        notes.append(Message("trajectory.note.empty-axes", axis=layout.columns[len(columns)].axis))
    is_extract = any(title.startswith(_RETURNED) for title in titles)
    form = "extract" if is_extract else "log" if COUNTER in [column.axis for column in others] else "table"
    whole = replace(
        source,
        file_format=Message(f"trajectory.format.{form}", encoding=source.file_format or ""),
        columns=(*columns, *extra),
        notes=tuple(notes),
    )
    return tuple(_split_parts(numbers[:, : len(columns)], extra, layout, whole, is_extract))


def _separator(head: Sequence[str]) -> str:
    """Return tab, semicolon or comma if at least half of the lines contain it; otherwise a space."""
    lines = [line for line in head if line.strip() and not line.lstrip().startswith("#")]
    for mark in "\t;,":
        if lines and 2 * sum(mark in line for line in lines) >= len(lines):
            return mark
    return " "


def _table_lines(lines: Iterable[str], separator: str) -> Iterator[TableLine]:
    reader = csv.reader(lines, delimiter=separator)
    if separator == " ":
        reader = csv.reader((" ".join(line.split()) for line in lines), delimiter=" ", quoting=csv.QUOTE_NONE)
    try:
        for cells in reader:
            if any(cells) and not cells[0].lstrip().startswith("#"):
                yield TableLine(reader.line_num, cells)
    except csv.Error as error:
        raise TrajectoryError(Message("trajectory.no-table", reason=str(error)), reader.line_num) from None


def _find_layout(first: Sequence[TableLine], options: ReadOptions) -> tuple[ColumnLayout, int, Sequence[str]]:
    """Return the layout of the columns, the number of header lines, and the titles; () without titles."""
    if _is_numeric(first[0]):
        bare = [
            [float_or_nan(cell.replace(",", ".")) for cell in line.cells if cell.strip()] for line in first
        ]
        even = [row for row in bare if len(row) == len(bare[0])]
        return layout_of_numbers(even, options), 0, ()
    for place, line in enumerate(first):
        if not _is_numeric(line):
            layout = layout_of_titles(line.cells, options)
            if layout is not None:
                return layout, place + 1, line.cells
    kind = options.kind
    wanted = Message("trajectory.wanted.kind", kind=kind) if kind else Message("trajectory.wanted.any")
    found = list_titles([cell.strip() for cell in first[0].cells])
    raise TrajectoryError(Message("trajectory.no-columns", wanted=wanted, titles=found), first[0].number)


def _is_numeric(line: TableLine) -> bool:
    return all(_NUMBER.fullmatch(cell) for cell in line.cells if cell.strip())


def _read_numbers(
    lines: Iterable[TableLine], columns: Sequence[Column], width: int, decimal_comma: bool
) -> tuple[Array, list[bool]]:
    """Return the numbers in the cells of the given columns, and whether each column is filled. An empty
    column gives NaN. Raises TrajectoryError if a cell is not a number, a column is empty in some lines only,
    or a line does not have `width` cells.
    """
    numbers, filled, count = array("d"), [False] * len(columns), 0
    for count, line in enumerate(lines, 1):
        if count > MAX_POINTS:
            raise TrajectoryError(Message("trajectory.too-long", limit=MAX_POINTS), line.number)
        if len(line.cells) < width or any(line.cells[width:]):
            found = Count(len(line.cells), "column")
            raise TrajectoryError(Message("trajectory.other-width", columns=found, width=width), line.number)
        for place, column in enumerate(columns):
            cell = line.cells[column.position - 1]
            full = bool(cell) and not cell.isspace()
            if count == 1:
                filled[place] = full
            elif full is not filled[place]:
                case = "trajectory.filled-later" if full else "trajectory.filled-before"
                raise TrajectoryError(Message(case, axis=column.axis), line.number, column.position)
            text = cell.replace(",", ".") if decimal_comma else cell
            numbers.append(_parse_number(text, line.number, column) if full else float("nan"))
    if not count:
        raise TrajectoryError(Message("trajectory.only-titles"))
    return np.frombuffer(numbers, dtype=np.float64).reshape(count, len(columns)).copy(), filled


def _parse_number(text: str, line: int, column: Column) -> float:
    try:
        if "_" not in text:
            return float(text) * column.factor
    except ValueError:
        pass
    reason = Message("trajectory.no-number", value=f"{text.strip()[:_PLAIN_CELLS]!r}", axis=column.axis)
    raise TrajectoryError(reason, line, column.position)


def _without_empty(layout: ColumnLayout, filled: Sequence[bool]) -> tuple[Column, ...]:
    """Return the columns before the first empty column. Raise TrajectoryError if these columns are too few
    for the pose type, or if a column after the first empty column has numbers.
    """
    columns, axes_filled = layout.columns, filled[: len(layout.columns)]
    width = axes_filled.index(False) if False in axes_filled else len(axes_filled)
    if any(axes_filled[width:]) or width < MIN_COLUMNS[layout.kind]:
        empty = columns[width]
        raise TrajectoryError(Message("trajectory.empty-column", axis=empty.axis), None, empty.position)
    return columns[:width]


def _split_parts(
    points: Array,
    extra: Mapping[Column, Array],
    layout: ColumnLayout,
    source: TrajectorySource,
    is_extract: bool,
) -> Iterator[Trajectory]:
    times, counter = (extra.get(column) if column else None for column in (layout.time, layout.counter))
    timing = SetPointTiming(None, None)
    if times is not None:
        timing = timing_from_send_times(times) if is_extract else timing_from_due_times(times)
    if times is not None or counter is None:
        yield _make_trajectory(layout.kind, points, source, timing)
        return
    runs, step = find_runs(counter)
    timing = _counter_timing(layout.counter, step)
    for start, stop in runs:
        part = Message("trajectory.part.records", first=start + 1, last=stop) if len(runs) > 1 else None
        notes = (Message("trajectory.note.counter-jumps"),) if part else ()
        piece = replace(source, part=part, notes=source.notes + notes)
        yield _make_trajectory(layout.kind, points[start:stop].copy(), piece, timing)


def _counter_timing(column: Column | None, step: float | None) -> SetPointTiming:
    """Guess the interval from the growth of the log's counter. No public source describes the counter."""
    if column is None or column.axis != COUNTER or step is None:
        return SetPointTiming(None, None)
    if step <= 1:
        return SetPointTiming(None, None, (Message("trajectory.note.counts-records"),))
    unit, period = ("ms", step / 1e3) if step < 1000 else ("µs", step / 1e6)
    note = Message("trajectory.note.counter-grows", step=f"{step:g}", unit=unit)
    return SetPointTiming(period, None, (note,))


def _make_trajectory(
    kind: PoseType, points: Array, source: TrajectorySource, timing: SetPointTiming
) -> Trajectory:
    source = replace(source, notes=(*source.notes, *timing.notes))
    return Trajectory(kind, points, source, timing.period, timing.times)
