"""Timing of set points: interval, evenness and gaps."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcapscope.messages import Message
from bcapscope.messages.places import Measured
from bcapscope.player.smooth_curve import Array
from bcapscope.protocol.slave_mode.modes import PERIOD_MS

CYCLES = (PERIOD_MS / 1000, 0.001)
"""Cycle times of set points, seconds (DENSO Wave 2009, How to use the Slave mode)."""

EVEN_TOLERANCE = 0.01
"""Maximum difference between intervals that are treated as even, as a share of the interval."""

MAX_PARTS = 64
"""Maximum number of trajectories into which records with gaps are split."""

GAP_FACTOR = 1.5
"""Number of usual intervals above which a step is a gap."""

_CYCLE_TOLERANCE = 0.05


class SetPointTiming(NamedTuple):
    """Timing of set points in seconds, and notes on assumptions.

    Attributes:
        period: Time between set points; None if this time is uneven or unknown.
        times: Times of the set points from the first one; None if the times have no meaning.
    """

    period: float | None
    times: Array | None
    notes: tuple[Message, ...] = ()


def timing_from_due_times(times: Array) -> SetPointTiming:
    """Return the timing that results from the times, in seconds, at which set points are due."""
    shifted = times - times[0]
    steps = np.diff(shifted)
    if not len(steps) or not np.isfinite(steps).all():
        return SetPointTiming(None, shifted)
    usual = float(np.median(steps))
    even = usual > 0 and float(np.abs(steps - usual).max()) <= EVEN_TOLERANCE * usual
    return SetPointTiming(round(usual, 9) if even else None, shifted)


def timing_from_send_times(times: Array) -> SetPointTiming:
    """Return the timing that results from the times, in seconds, at which set points were sent.

    If the usual interval is close to a cycle time, each set point counts as one cycle. A controller takes one
    set point per cycle, whatever its exact arrival time.
    """
    steps = np.diff(times)
    if not len(steps):
        return SetPointTiming(CYCLES[0], None)
    usual = float(np.median(steps))
    cycle = next((cycle for cycle in CYCLES if abs(usual - cycle) <= _CYCLE_TOLERANCE * cycle), None)
    if cycle is None:
        return timing_from_due_times(times)
    longest = float(steps.max())
    notes = [Message("trajectory.note.cycle", cycle=Measured(cycle * 1000, "ms"))]
    if longest > 2 * cycle:
        notes.append(Message("trajectory.note.pause", longest=Measured(longest * 1000, "ms", 3)))
    return SetPointTiming(cycle, None, tuple(notes))


def find_gaps(times: Array) -> NDArray[np.bool_]:
    """Return, for each step between two times, whether it is a gap where set points may be missing."""
    steps = np.diff(times)
    return np.asarray(steps > GAP_FACTOR * np.median(steps))


def find_runs(counter: Array) -> tuple[tuple[tuple[int, int], ...], float | None]:
    """Use a counter to find the runs of records without gaps; also return its growth per record.

    A run is a pair: the index of its first record, from 0, and the index after its last record. If the
    counter does not grow evenly enough, return one run of all records, and None.
    """
    whole = ((0, len(counter)),)
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
    return tuple(pairwise(edges)), usual
