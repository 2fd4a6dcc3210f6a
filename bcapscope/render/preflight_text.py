"""What a file was read as, and the pre-flight, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite

import orjson

from bcapscope.analysis.finding import Severity
from bcapscope.player.motion_checks import AxisFigures
from bcapscope.player.preflight import PreflightResult
from bcapscope.player.preflight_problem import PreflightProblem
from bcapscope.player.trajectory import Column, Trajectory
from bcapscope.protocol.text_format import counted
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import align_columns, wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.tongue import Tongue, english

NARROWEST, WIDEST = 40, 120
"""Columns that text is wrapped to at least and at most."""

_LONGEST_TITLE = 40
_LARGEST_SHOWN = 1e12
_HEAD = ("axis", "unit", "from", "to", "step", "speed/s", "acceleration/s²", "fastest at")


def trajectory_line(number: int, trajectory: Trajectory, tongue: Tongue = english) -> str:
    """Write one of several trajectories in a line, to choose from."""
    part = printable(tongue(trajectory.source.part or "all of it"))
    return f"{number}: {part}, {tongue(_size(trajectory))}"


def source_lines(trajectory: Trajectory, tongue: Tongue = english, width: int = WIDEST) -> Iterator[str]:
    """Yield what a file was read as: size, interval, the column of each axis with its unit, and notes."""
    source = trajectory.source
    part = f", {printable(tongue(source.part))}" if source.part else ""
    yield f"{printable(source.path)}: {printable(tongue(source.file_format))}{part}"
    yield f"  {tongue(_size(trajectory))}, {tongue(_interval(trajectory))}"
    if source.columns:
        rows = [
            (tongue(column.axis), tongue(f"from {_place(column)}"), tongue(_unit(column)))
            for column in source.columns
        ]
        yield from (f"  {line}" for line in align_columns(rows, "<<<"))
    for note in source.notes:
        yield from (f"  {line}" for line in wrap_text(printable(tongue(note)), width - 2))


class PreflightRenderer:
    """Writes a pre-flight as text."""

    def __init__(self, palette: Palette = PLAIN, width: int = 100, tongue: Tongue = english) -> None:
        self._palette = palette
        self._width = min(max(width, NARROWEST), WIDEST)
        self._tongue = tongue

    def lines(self, preflight: PreflightResult) -> Iterator[str]:
        """Yield a table of what each axis does, the findings, and one line that sums up."""
        if preflight.axis_figures:
            yield from align_columns(
                [tuple(map(self._tongue, _HEAD)), *map(self._axis_cells, preflight.axis_figures)], "<<>>>>>>"
            )
            yield ""
        for finding in preflight.problems:
            yield from self._problem_lines(finding)
        yield self._verdict_line(preflight)

    def _axis_cells(self, figures: AxisFigures) -> Sequence[str]:
        return (
            figures.axis.name,
            figures.axis.unit,
            _bounded_number(round(figures.low, 3) + 0.0, 3),
            _bounded_number(round(figures.high, 3) + 0.0, 3),
            _bounded_number(figures.step, 4),
            self._tongue(_value_of_limit(figures.speed, figures.limit.speed)),
            self._tongue(_value_of_limit(figures.acceleration, figures.limit.acceleration)),
            str(figures.fastest),
        )

    def _verdict_line(self, preflight: PreflightResult) -> str:
        color, tongue = self._palette, self._tongue
        count = tongue(counted(len(preflight.trajectory), "set point"))
        size = (
            f"{count}, {_bounded_number(preflight.seconds, 3)} s, {tongue(f'limits of {preflight.arm_name}')}"
        )
        if not preflight.is_playable:
            return f"{color.bad}{tongue('not fit to play')}{color.reset}: {size}"
        move = f", {tongue('after a slow Move to the first point')}" if preflight.needs_approach else ""
        return f"{color.good}{tongue('fit to play')}{color.reset}{move}: {size}"

    def _problem_lines(self, finding: PreflightProblem) -> Iterator[str]:
        color, tongue = self._palette, self._tongue
        shade = color.problem if finding.severity is Severity.ERROR else color.name
        head = f"{tongue(finding.severity)} {finding.check}:"
        sentence = f"{printable(tongue(finding.sentence))}{tongue(_points(finding))}"
        first, *rest = wrap_text(f"{head} {sentence}", self._width - 2)
        yield f"{shade}{head}{color.reset}{first.removeprefix(head)}"
        yield from (f"  {line}" for line in rest)
        if finding.advice:
            advice = wrap_text(tongue(f"what to do: {finding.advice}"), self._width - 2)
            yield from (f"  {color.good}{line}{color.reset}" for line in advice)


def preflight_record(preflight: PreflightResult) -> bytes:
    """Write a pre-flight as a JSON object; strings are escaped as on a terminal, infinite limits are null."""
    trajectory, source = preflight.trajectory, preflight.trajectory.source
    return orjson.dumps(
        {
            "path": printable(source.path),
            "form": printable(source.file_format),
            "part": printable(source.part),
            "type": trajectory.kind.value,
            "set_points": len(trajectory),
            "period_ms": None if trajectory.period is None else trajectory.period * 1000,
            "columns": [_column_record(column) for column in source.columns],
            "notes": [printable(note) for note in source.notes],
            "cycle_ms": preflight.period * 1000,
            "seconds": preflight.seconds,
            "limits_of": preflight.arm_name,
            "fit": preflight.is_playable,
            "needs_move": preflight.needs_approach,
            "distance": preflight.first_point_offsets,
            "axes": [_axis_record(figures) for figures in preflight.axis_figures],
            "findings": [_problem_record(finding) for finding in preflight.problems],
        }
    )


def _size(trajectory: Trajectory) -> str:
    names = [axis.name for axis in trajectory.axes]
    axes = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    return f"{counted(len(trajectory), 'set point')}, {trajectory.kind} type, {axes}"


def _interval(trajectory: Trajectory) -> str:
    if trajectory.period is not None:
        return f"one each {trajectory.period * 1000:.6g} ms"
    return "interval not told" if trajectory.times is None else "with times that are not even"


def _place(column: Column) -> str:
    title = printable(column.name[:_LONGEST_TITLE])
    if not column.position:
        return f"field {title}"
    return f"column {column.position}{f', {title}' if title else ''}"


def _unit(column: Column) -> str:
    return f"in {column.unit}" if column.unit else ""


def _value_of_limit(value: float, limit: float) -> str:
    return (
        f"{_bounded_number(value, 1)} of {_bounded_number(limit, 0)}"
        if isfinite(limit)
        else _bounded_number(value, 1)
    )


def _bounded_number(value: float, digits: int) -> str:
    """Write a number with so many digits behind the point, and what is absurd in no more columns."""
    return f"{value:.{digits}f}" if abs(value) < _LARGEST_SHOWN else f"{value:.3g}"


def _points(finding: PreflightProblem) -> str:
    if not finding.points or finding.count < 1:
        return ""
    more = ", …" if finding.count > len(finding.points) else ""
    return f" (set point{'' if finding.count == 1 else 's'} {', '.join(map(str, finding.points))}{more})"


def _column_record(column: Column) -> dict[str, object]:
    return {
        "axis": column.axis,
        "column": column.position,
        "title": printable(column.name),
        "unit": column.unit,
        "factor": column.factor,
    }


def _axis_record(figures: AxisFigures) -> dict[str, object]:
    return {
        "axis": figures.axis.name,
        "unit": figures.axis.unit,
        "low": figures.low,
        "high": figures.high,
        "step": figures.step,
        "speed": figures.speed,
        "acceleration": figures.acceleration,
        "fastest": figures.fastest,
        "limits": figures.limit._asdict(),
    }


def _problem_record(finding: PreflightProblem) -> dict[str, object]:
    return {
        "check": finding.check,
        "severity": finding.severity.value,
        "sentence": printable(finding.sentence),
        "advice": finding.advice,
        "points": finding.points,
        "count": finding.count,
    }
