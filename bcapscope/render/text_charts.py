"""Charts drawn with characters: curves, histograms and sparklines."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import TypeAlias

from bcapscope.analysis.statistics.distribution_summary import Bin
from bcapscope.render.color_palette import PLAIN, Palette

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BLANK = 0x2800
_LABEL = 9
_LARGEST = 1e9


ChartCurve: TypeAlias = "tuple[Sequence[tuple[float, float]], str]"


def braille_chart(
    curves: Sequence[ChartCurve], width: int, height: int, palette: Palette = PLAIN, unit: str = ""
) -> list[str]:
    """Draw curves in braille characters, with at least 2 lines and 11 columns. Leave out points with a
    coordinate of 1e9 or more.

    Labels at the left show the range of y in `unit`. Labels below the chart show the range of x in seconds.
    """
    columns, rows = max(1, width - _LABEL - 1), max(1, height - 1)
    finite = [
        ([(x, y) for x, y in points if abs(x) < _LARGEST and abs(y) < _LARGEST], style)
        for points, style in curves
    ]
    everything = [point for points, _ in finite for point in points]
    if not everything:
        return [" " * _LABEL + f"{palette.dim}│{palette.reset}"] * rows + [""]
    (left, right), (low, high) = (_span([point[axis] for point in everything]) for axis in (0, 1))
    cells = [[_BLANK] * columns for _ in range(rows)]
    styles = [[""] * columns for _ in range(rows)]
    for points, style in finite:
        dots = [
            (_place(x, left, right, 2 * columns), 4 * rows - 1 - _place(y, low, high, 4 * rows))
            for x, y in points
        ]
        for across, down in _joined(dots):
            cells[down // 4][across // 2] |= _DOTS[down % 4][across % 2]
            styles[down // 4][across // 2] = style
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
    texts = (f"{value:.{digits}g}{unit}" for digits in (4, 3, 2, 1))
    return next((text for text in texts if len(text) <= _LABEL), f"{value:.0e}")


def _row(cells: Sequence[int], styles: Sequence[str], reset: str) -> str:
    parts = []
    for style, run in groupby(range(len(cells)), lambda index: styles[index]):
        text = "".join(chr(cells[index]) if cells[index] != _BLANK else " " for index in run)
        parts.append(f"{style}{text}{reset}" if style else text)
    return "".join(parts)


BAR_WIDTH = 40

_EIGHTHS = " ▏▎▍▌▋▊▉█"
_NEAR = tuple(2.0**-power for power in range(10, 1, -1))
_AROUND = (0.5, 0.75, 0.875, 0.9375, 0.9875, 1.0125, 1.0625, 1.125, 1.25, 1.5, 2.0, 3.0)
_FAR = tuple(2.0**power for power in range(2, 21))

DECADE_EDGES = tuple(step * 10.0**power for power in range(-4, 9) for step in (1, 2, 5))
"""Bin edges for values of any size: 1, 2, 5, 10, 20, 50 and so on."""


def edges_around(period: float) -> tuple[float, ...]:
    """Return bin edges for values near `period`: narrow bins around `period`, wide bins far from it."""
    return tuple(period * factor for factor in (*_NEAR, *_AROUND, *_FAR))


def histogram(bins: Sequence[Bin], edges: Sequence[float], palette: Palette = PLAIN) -> Iterator[str]:
    """Yield one line per interval between two edges, from the first to the last interval that has values.

    The middle of a bin decides which interval gets its values. An interval with values has a visible bar.
    """
    counts = [0] * (len(edges) + 1)
    for each in bins:
        counts[bisect_right(edges, (each.low + each.high) / 2)] += each.count
    filled = [row for row, count in enumerate(counts) if count]
    if not filled:
        return
    total, most = sum(counts), max(counts)
    for row in range(filled[0], filled[-1] + 1):
        count = counts[row]
        share = f"{count / total:7.2%}" if count else ""
        bar = f"{palette.number}{_bar(count / most)}{palette.reset}"
        yield f"{_interval(edges, row)}  {bar} {count:>{len(str(most))}}  {share}".rstrip()


def _bar(share: float) -> str:
    eighths = round(share * BAR_WIDTH * 8)
    if share and not eighths:
        eighths = 1
    whole, part = divmod(eighths, 8)
    drawn = "█" * whole + (_EIGHTHS[part] if part else "")
    return drawn.ljust(BAR_WIDTH)


def _interval(edges: Sequence[float], row: int) -> str:
    low = "" if row == 0 else f"{edges[row - 1]:.4g}"
    high = "" if row == len(edges) else f"{edges[row]:.4g}"
    return f"{low:>8} – {high:<8}"


_LEVELS = "▁▂▃▄▅▆▇█"
_HOLE = "·"


def sparkline(values: Sequence[float]) -> str:
    """Return one bar character per value, scaled from smallest to largest. NaN and infinities are dots."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return _HOLE * len(values)
    least, most = min(finite), max(finite)
    return "".join(_step(value, least, most) for value in values)


def _step(value: float, least: float, most: float) -> str:
    if not math.isfinite(value):
        return _HOLE
    # Halve the values first, because the difference of very large numbers would be infinite.
    span = most / 2 - least / 2
    share = (value / 2 - least / 2) / span if span else 0.0
    return _LEVELS[min(len(_LEVELS) - 1, int(share * len(_LEVELS)))]
