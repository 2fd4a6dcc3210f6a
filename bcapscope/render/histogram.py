"""Histograms drawn with characters."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence

from bcapscope.analysis.statistics.distribution_summary import Bin
from bcapscope.render.color_palette import PLAIN, Palette

BAR_WIDTH = 40

_EIGHTHS = " ▏▎▍▌▋▊▉█"
_NEAR = tuple(2.0**-power for power in range(10, 1, -1))
_AROUND = (0.5, 0.75, 0.875, 0.9375, 0.9875, 1.0125, 1.0625, 1.125, 1.25, 1.5, 2.0, 3.0)
_FAR = tuple(2.0**power for power in range(2, 21))
_STEPS = tuple(step * 10.0**power for power in range(-4, 9) for step in (1, 2, 5))


def edges_around(period: float) -> tuple[float, ...]:
    """Return bin edges for values near `period`: narrow bins around `period`, wide bins far from it."""
    return tuple(period * factor for factor in (*_NEAR, *_AROUND, *_FAR))


def edges_by_decades() -> tuple[float, ...]:
    """Return bin edges for values of any size: 1, 2, 5, 10, 20, 50 and so on."""
    return _STEPS


def histogram(bins: Sequence[Bin], edges: Sequence[float], palette: Palette = PLAIN) -> Iterator[str]:
    """Yield one line per interval between two edges, from the first to the last interval that has values.

    All values of a bin belong to the interval that contains the middle of the bin. An interval with at least
    one value always has a bar, so that rare values are visible.
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
        yield f"{_span(edges, row)}  {bar} {count:>{len(str(most))}}  {share}".rstrip()


def _bar(share: float) -> str:
    eighths = round(share * BAR_WIDTH * 8)
    if share and not eighths:
        eighths = 1
    whole, part = divmod(eighths, 8)
    drawn = "█" * whole + (_EIGHTHS[part] if part else "")
    return drawn.ljust(BAR_WIDTH)


def _span(edges: Sequence[float], row: int) -> str:
    low = "" if row == 0 else f"{edges[row - 1]:.4g}"
    high = "" if row == len(edges) else f"{edges[row]:.4g}"
    return f"{low:>8} – {high:<8}"
