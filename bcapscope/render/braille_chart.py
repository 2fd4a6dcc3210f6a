"""Charts drawn with braille characters: each character is two dots wide and four dots high."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

from bcapscope.render.color_palette import PLAIN, Palette

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BLANK = 0x2800
_LABEL = 9
_LARGEST = 1e9


class ChartCurve(NamedTuple):
    """A curve of a chart.

    The chart leaves out a point if the absolute value of a coordinate is 1e9 or more.
    """

    points: Sequence[tuple[float, float]]
    style: str = ""


def braille_chart(
    curves: Sequence[ChartCurve], width: int, height: int, palette: Palette = PLAIN, unit: str = ""
) -> list[str]:
    """Return a chart of all curves, with at least 2 lines and 11 columns.

    `height` is the number of lines, `width` the number of columns. Labels at the left show the range of y in
    `unit`. Labels below show the range of x in seconds.
    """
    columns, rows = max(1, width - _LABEL - 1), max(1, height - 1)
    finite = [
        [(x, y) for x, y in curve.points if abs(x) < _LARGEST and abs(y) < _LARGEST] for curve in curves
    ]
    everything = [point for points in finite for point in points]
    if not everything:
        return [" " * _LABEL + f"{palette.dim}│{palette.reset}"] * rows + [""]
    (left, right), (low, high) = (_span([point[axis] for point in everything]) for axis in (0, 1))
    cells = [[_BLANK] * columns for _ in range(rows)]
    styles = [[""] * columns for _ in range(rows)]
    for curve, points in zip(curves, finite, strict=True):
        dots = [
            (_place(x, left, right, 2 * columns), 4 * rows - 1 - _place(y, low, high, 4 * rows))
            for x, y in points
        ]
        for across, down in _joined(dots):
            cells[down // 4][across // 2] |= _DOTS[down % 4][across % 2]
            styles[down // 4][across // 2] = curve.style
    lines = [
        f"{palette.dim}{_label(row, rows, low, high, unit):>{_LABEL}}│{palette.reset}"
        f"{_row(cells[row], styles[row], palette.reset)}"
        for row in range(rows)
    ]
    ends = f"{left:.1f} s".ljust(columns - len(f"{right:.1f} s")) + f"{right:.1f} s"
    return [*lines, f"{palette.dim}{' ' * (_LABEL + 1)}{ends[:columns]}{palette.reset}"]


def _span(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    if high - low < 1e-5:
        middle = (low + high) / 2
        return middle - 0.5, middle + 0.5
    return low, high


def _place(value: float, low: float, high: float, count: int) -> int:
    share = (value - low) / (high - low)
    return max(0, min(count - 1, int(share * count)))


def _joined(dots: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    found = list(dots[:1])
    for (x, y), (to_x, to_y) in pairwise(dots):
        steps = max(abs(to_x - x), abs(to_y - y), 1)
        found += [
            (x + round((to_x - x) * step / steps), y + round((to_y - y) * step / steps))
            for step in range(1, steps + 1)
        ]
    return found


def _label(row: int, rows: int, low: float, high: float, unit: str) -> str:
    if row == 0:
        return _short(high, unit)
    return _short(low, unit) if row == rows - 1 else ""


def _short(value: float, unit: str) -> str:
    """Return a number with its unit. The number has four digits, or fewer if four do not fit into the
    label."""
    texts = (f"{value:.{digits}g}{unit}" for digits in (4, 3, 2, 1))
    return next((text for text in texts if len(text) <= _LABEL), f"{value:.0e}")


def _row(cells: Sequence[int], styles: Sequence[str], reset: str) -> str:
    parts = []
    for style, run in groupby(range(len(cells)), lambda index: styles[index]):
        text = "".join(chr(cells[index]) if cells[index] != _BLANK else " " for index in run)
        parts.append(f"{style}{text}{reset}" if style else text)
    return "".join(parts)
