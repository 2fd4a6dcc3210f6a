"""What the times of set points say: how far apart they are, whether they are even, where some are missing."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.player.curve import Array

CYCLES = (0.008, 0.001)
"""Seconds; what set points are sent in (DENSO Wave 2009, How to use the Slave mode)."""

EVEN = 0.01
"""Share of the interval that times may be off and still be even."""

MOST_PARTS = 64
"""Trajectories that records with gaps between them are taken apart to."""

GAP = 1.5
"""Usual intervals; something may be missing where there is more."""

_NEAR_CYCLE = 0.05


class Timing(NamedTuple):
    """What times say.

    Attributes:
        period: seconds, if they are even.
        times: seconds from the first; None where they say nothing.
        note: one clause; may be empty.
    """

    period: float | None
    times: Array | None
    note: str = ""


def of_times(times: Array) -> Timing:
    """Read times that tell when each set point is due, seconds."""
    shifted = times - times[0]
    steps = np.diff(shifted)
    if not len(steps) or not np.isfinite(steps).all():
        return Timing(None, shifted)
    usual = float(np.median(steps))
    even = usual > 0 and float(np.abs(steps - usual).max()) <= EVEN * usual
    return Timing(round(usual, 9) if even else None, shifted)


def of_sending(times: Array) -> Timing:
    """Read times at which set points were sent: a controller takes one a cycle whenever exactly they came."""
    steps = np.diff(times)
    if not len(steps):
        return Timing(CYCLES[0], None)
    usual = float(np.median(steps))
    cycle = next((cycle for cycle in CYCLES if abs(usual - cycle) <= _NEAR_CYCLE * cycle), None)
    if cycle is None:
        return of_times(times)
    longest = float(steps.max())
    note = f"each set point counts as one cycle of {cycle * 1000:g} ms, whenever it was sent"
    if longest > 2 * cycle:
        note += f"; the longest pause between two was {longest * 1000:.3g} ms"
    return Timing(cycle, None, note)


def gaps(times: Array) -> NDArray[np.bool_]:
    """Tell for each step from one time to the next whether it is so long that something may be missing."""
    steps = np.diff(times)
    return np.asarray(steps > GAP * np.median(steps))


class Run(NamedTuple):
    """Records that follow each other.

    Attributes:
        start: of them, counted from 0.
        stop: behind them.
    """

    start: int
    stop: int


def runs(counter: Array) -> tuple[tuple[Run, ...], float | None]:
    """Find where records follow each other, by a counter.

    Returns:
        The runs, in order, and how much the counter grows from one record to the next; one run of all and
        None where the counter does not grow evenly enough to tell.
    """
    whole = (Run(0, len(counter)),)
    steps = np.diff(counter)
    if not len(steps) or not np.isfinite(steps).all():
        return whole, None
    usual = float(np.median(steps))
    if usual <= 0:
        return whole, None
    breaks = np.flatnonzero((steps > GAP * usual) | (steps <= 0)) + 1
    if len(breaks) >= MOST_PARTS:
        return whole, None
    edges = [0, *breaks.tolist(), len(counter)]
    return tuple(Run(start, stop) for start, stop in pairwise(edges)), usual
