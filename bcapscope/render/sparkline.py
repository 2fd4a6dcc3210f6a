"""A sparkline: a small chart of numbers in one line of text."""

from __future__ import annotations

import math
from collections.abc import Sequence

_STEPS = "▁▂▃▄▅▆▇█"
_HOLE = "·"


def sparkline(values: Sequence[float]) -> str:
    """Return one character per value, scaled from the smallest to the largest.

    NaN and infinities become dots.
    """
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
    return _STEPS[min(len(_STEPS) - 1, int(share * len(_STEPS)))]
