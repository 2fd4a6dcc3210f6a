"""A course of numbers in one line."""

from __future__ import annotations

import math
from collections.abc import Sequence

_STEPS = "▁▂▃▄▅▆▇█"
_HOLE = "·"


def sparkline(values: Sequence[float]) -> str:
    """Draw one character per value, between the least and the most; NaN and infinities are holes."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return _HOLE * len(values)
    least, most = min(finite), max(finite)
    return "".join(_step(value, least, most) for value in values)


def _step(value: float, least: float, most: float) -> str:
    if not math.isfinite(value):
        return _HOLE
    # Halves, as the difference of the largest numbers would be infinite.
    span = most / 2 - least / 2
    share = (value / 2 - least / 2) / span if span else 0.0
    return _STEPS[min(len(_STEPS) - 1, int(share * len(_STEPS)))]
