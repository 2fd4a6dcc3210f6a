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
"""Share of the interval by which even times may differ."""

MAX_PARTS = 64
"""Trajectories into which records with gaps are split at most."""

GAP_FACTOR = 1.5
"""A step longer than this many usual intervals is a gap."""

_CYCLE_TOLERANCE = 0.05


class SetPointTiming(NamedTuple):
    """Timing of set points in seconds, and notes on what was assumed.

    Attributes:
        period: Time between set points; None if uneven or unknown.
        times: Times from the first set point; None if they have no meaning.
    """

    period: float | None
    times: Array | None
    notes: tuple[Message, ...] = ()


def timing_from_due_times(times: Array) -> SetPointTiming:
    """Return the timing from the times at which set points are due, seconds."""
    shifted = times - times[0]
    steps = np.diff(shifted)
    if not len(steps) or not np.isfinite(steps).all():
        return SetPointTiming(None, shifted)
    usual = float(np.median(steps))
    even = usual > 0 and float(np.abs(steps - usual).max()) <= EVEN_TOLERANCE * usual
    return SetPointTiming(round(usual, 9) if even else None, shifted)


def timing_from_send_times(times: Array) -> SetPointTiming:
    """Return the timing from the times at which set points were sent, seconds.

    If these are close to a cycle time, each set point counts as one cycle: a controller takes one set point
    per cycle, whenever exactly it came.
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
    """Return for each step from one time to the next whether it is a gap, where set points may be missing."""
    steps = np.diff(times)
    return np.asarray(steps > GAP_FACTOR * np.median(steps))


def find_runs(counter: Array) -> tuple[tuple[tuple[int, int], ...], float | None]:
    """Find the runs of records without gaps by a counter, and the growth of the counter per record.

    A run is the index of its first record, from 0, and that after its last. If the counter does not grow
    evenly enough, return one run and None.
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
