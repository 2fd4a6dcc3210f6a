"""What the times of set points say: how far apart they are, whether they are even, where some are missing."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.player.smooth_curve import Array

CYCLES = (0.008, 0.001)
"""Seconds; what set points are sent in (DENSO Wave 2009, How to use the Slave mode)."""

EVEN_TOLERANCE = 0.01
"""Share of the interval that times may be off and still be even."""

MAX_PARTS = 64
"""Trajectories that records with gaps between them are taken apart to."""

GAP_FACTOR = 1.5
"""Usual intervals; something may be missing where there is more."""

_CYCLE_TOLERANCE = 0.05


class SetPointTiming(NamedTuple):
    """What times say.

    Attributes:
        period: seconds, if they are even.
        times: seconds from the first; None where they say nothing.
        note: one clause; may be empty.
    """

    period: float | None
    times: Array | None
    note: str = ""


def timing_from_due_times(times: Array) -> SetPointTiming:
    """Read times that tell when each set point is due, seconds."""
    shifted = times - times[0]
    steps = np.diff(shifted)
    if not len(steps) or not np.isfinite(steps).all():
        return SetPointTiming(None, shifted)
    usual = float(np.median(steps))
    even = usual > 0 and float(np.abs(steps - usual).max()) <= EVEN_TOLERANCE * usual
    return SetPointTiming(round(usual, 9) if even else None, shifted)


def timing_from_send_times(times: Array) -> SetPointTiming:
    """Read times at which set points were sent: a controller takes one a cycle whenever exactly they came."""
    steps = np.diff(times)
    if not len(steps):
        return SetPointTiming(CYCLES[0], None)
    usual = float(np.median(steps))
    cycle = next((cycle for cycle in CYCLES if abs(usual - cycle) <= _CYCLE_TOLERANCE * cycle), None)
    if cycle is None:
        return timing_from_due_times(times)
    longest = float(steps.max())
    note = f"each set point counts as one cycle of {cycle * 1000:g} ms, whenever it was sent"
    if longest > 2 * cycle:
        note += f"; the longest pause between two was {longest * 1000:.3g} ms"
    return SetPointTiming(cycle, None, note)


def find_gaps(times: Array) -> NDArray[np.bool_]:
    """Tell for each step from one time to the next whether it is so long that something may be missing."""
    steps = np.diff(times)
    return np.asarray(steps > GAP_FACTOR * np.median(steps))


class RecordRun(NamedTuple):
    """Records that follow each other.

    Attributes:
        start: of them, counted from 0.
        stop: behind them.
    """

    start: int
    stop: int


def find_runs(counter: Array) -> tuple[tuple[RecordRun, ...], float | None]:
    """Find where records follow each other, by a counter.

    Returns:
        The runs, in order, and how much the counter grows from one record to the next; one run of all and
        None where the counter does not grow evenly enough to tell.
    """
    whole = (RecordRun(0, len(counter)),)
    steps = np.diff(counter)
    if not len(steps) or not np.isfinite(steps).all():
        return whole, None
    usual = float(np.median(steps))
    if usual <= 0:
        return whole, None
    breaks = np.flatnonzero((steps > GAP_FACTOR * usual) | (steps <= 0)) + 1
    if len(breaks) >= MAX_PARTS:
        return whole, None
    edges = [0, *breaks.tolist(), len(counter)]
    return tuple(RecordRun(start, stop) for start, stop in pairwise(edges)), usual
