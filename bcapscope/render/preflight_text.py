"""Text and JSON about how a trajectory file was read, and about the result of the pre-flight check."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite

import orjson

from bcapscope.analysis.finding import Severity
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.message import message_params
from bcapscope.messages.places import Count, Measured
from bcapscope.player.checks import PreflightProblem
from bcapscope.player.motion_checks import AxisFigures
from bcapscope.player.preflight import PreflightResult
from bcapscope.player.trajectory import Column, Trajectory
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.columns import align_columns, wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.findings import NARROWEST, WIDEST

_LONGEST_TITLE = 40
_LARGEST_SHOWN = 1e12
_HEAD = ("axis", "unit", "from", "to", "step", "speed", "acceleration", "fastest")


def trajectory_line(number: int, trajectory: Trajectory, words: MessageFormatter = ENGLISH_WORDS) -> str:
    """Describe one of several trajectories in a file. The line begins with the number for ``--index``."""
    part = trajectory.source.part or Message("trajectory.all")
    return f"{number}: {printable(words.text(part))}, {words.text(_size(trajectory))}"


def source_lines(
    trajectory: Trajectory, words: MessageFormatter = ENGLISH_WORDS, width: int = WIDEST
) -> Iterator[str]:
    """Say how a file was read: format, size, interval, the column and unit of each axis, and notes."""
    source = trajectory.source
    texts = [words.text(each) for each in (source.file_format, source.part) if each is not None]
    yield f"{printable(source.path)}: {printable(', '.join(texts))}"
    yield f"  {words.text(_size(trajectory))}, {words.text(_interval(trajectory))}"
    if source.columns:
        rows = [
            (
                words("trajectory.time") if column.axis == "time" else column.axis,
                words.text(_place(column)),
                words("trajectory.unit", unit=column.unit) if column.unit else "",
            )
            for column in source.columns
        ]
        yield from (f"  {line}" for line in align_columns(rows, "<<<"))
    for note in source.notes:
        yield from (f"  {line}" for line in wrap_text(printable(words.text(note)), width - 2))


class PreflightRenderer:
    def __init__(
        self, palette: Palette = PLAIN, width: int = 100, words: MessageFormatter = ENGLISH_WORDS
    ) -> None:
        self._palette = palette
        self._width = min(max(width, NARROWEST), WIDEST)
        self._words = words

    def lines(self, preflight: PreflightResult) -> Iterator[str]:
        if preflight.axis_figures:
            head = tuple(self._words(f"preflight.head.{name}") for name in _HEAD)
            yield from align_columns([head, *map(self._axis_cells, preflight.axis_figures)], "<<>>>>>>")
            yield ""
        for problem in preflight.problems:
            yield from self._problem_lines(problem)
        yield self._verdict_line(preflight)

    def _axis_cells(self, figures: AxisFigures) -> Sequence[str]:
        return (
            figures.axis.name,
            figures.axis.unit,
            _bounded_number(round(figures.low, 3) + 0.0, 3),
            _bounded_number(round(figures.high, 3) + 0.0, 3),
            _bounded_number(figures.step, 4),
            self._value_of_limit(figures.speed, figures.limit.speed),
            self._value_of_limit(figures.acceleration, figures.limit.acceleration),
            str(figures.fastest),
        )

    def _value_of_limit(self, value: float, limit: float) -> str:
        shown = _bounded_number(value, 1)
        if not isfinite(limit):
            return shown
        return self._words("preflight.of-limit", value=shown, limit=_bounded_number(limit, 0))

    def _verdict_line(self, preflight: PreflightResult) -> str:
        color, words = self._palette, self._words
        size = words(
            "preflight.summary",
            points=Count(len(preflight.trajectory), "set-point"),
            seconds=_bounded_number(preflight.seconds, 3),
            arm=preflight.arm_name,
        )
        if not preflight.is_playable:
            return f"{color.bad}{words('preflight.unfit')}{color.reset}: {size}"
        move = f", {words('preflight.approach')}" if preflight.needs_approach else ""
        return f"{color.good}{words('preflight.fit')}{color.reset}{move}: {size}"

    def _problem_lines(self, problem: PreflightProblem) -> Iterator[str]:
        color, words = self._palette, self._words
        shade = color.problem if problem.severity is Severity.ERROR else color.name
        head = f"{words(f'severity.{problem.severity}')} {problem.check}:"
        sentence = f"{printable(words.text(problem.fact))}{self._points(problem)}"
        first, *rest = wrap_text(f"{head} {sentence}", self._width - 2)
        yield f"{shade}{head}{color.reset}{first.removeprefix(head)}"
        yield from (f"  {line}" for line in rest)
        if problem.advice is not None:
            advice = wrap_text(words("preflight.advice", advice=problem.advice), self._width - 2)
            yield from (f"  {color.good}{line}{color.reset}" for line in advice)

    def _points(self, problem: PreflightProblem) -> str:
        if not problem.points or problem.count < 1:
            return ""
        more = ", …" if problem.count > len(problem.points) else ""
        numbers = f"{', '.join(map(str, problem.points))}{more}"
        return self._words("preflight.point" if problem.count == 1 else "preflight.points", numbers=numbers)


def preflight_record(preflight: PreflightResult) -> bytes:
    """Return a pre-flight check as JSON. Non-printable characters are escaped. Infinite limits are null."""
    trajectory, source = preflight.trajectory, preflight.trajectory.source
    return orjson.dumps(
        {
            "path": printable(source.path),
            "form": _text(source.file_format),
            "part": _text(source.part),
            "type": trajectory.kind.value,
            "set_points": len(trajectory),
            "period_ms": None if trajectory.period is None else trajectory.period * 1000,
            "columns": [
                {
                    "axis": column.axis,
                    "column": column.position,
                    "title": printable(column.name),
                    "unit": column.unit,
                    "factor": column.factor,
                }
                for column in source.columns
            ],
            "notes": [printable(str(note)) for note in source.notes],
            "cycle_ms": preflight.period * 1000,
            "seconds": preflight.seconds,
            "limits_of": str(preflight.arm_name),
            "fit": preflight.is_playable,
            "needs_move": preflight.needs_approach,
            "distance": preflight.first_point_offsets,
            "axes": [_axis_record(figures) for figures in preflight.axis_figures],
            "findings": [_problem_record(each) for each in preflight.problems],
        }
    )


def _text(message: Message | None) -> str:
    return "" if message is None else printable(str(message))


def _size(trajectory: Trajectory) -> Message:
    points, kind = Count(len(trajectory), "set-point"), str(trajectory.kind)
    first, last = trajectory.axes[0].name, trajectory.axes[-1].name
    if first == last:
        return Message("trajectory.size.one", points=points, kind=kind, axis=first)
    return Message("trajectory.size", points=points, kind=kind, first=first, last=last)


def _interval(trajectory: Trajectory) -> Message:
    if trajectory.period is not None:
        return Message("trajectory.interval", interval=Measured(trajectory.period * 1000, "ms"))
    return Message("trajectory.interval.none" if trajectory.times is None else "trajectory.interval.uneven")


def _place(column: Column) -> Message:
    title = printable(column.name[:_LONGEST_TITLE])
    if not column.position:
        return Message("trajectory.field", title=title)
    if title:
        return Message("trajectory.column.titled", position=column.position, title=title)
    return Message("trajectory.column", position=column.position)


def _bounded_number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if abs(value) < _LARGEST_SHOWN else f"{value:.3g}"


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


def _problem_record(problem: PreflightProblem) -> dict[str, object]:
    return {
        "check": problem.check,
        "severity": problem.severity.value,
        "sentence": printable(str(problem.fact)),
        "advice": "" if problem.advice is None else str(problem.advice),
        "params": message_params(problem.fact),
        "points": problem.points,
        "count": problem.count,
    }
