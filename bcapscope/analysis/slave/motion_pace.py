"""The pace of set points while the robot moves, and whether the replies set this pace.

A cycle is the time from one set point to the next. A client may slow down while the robot stands still.
Therefore the pace includes a cycle only if both of its set points move the robot. The pace does not include a
cycle after a retried or unanswered set point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import Bools, Floats, Histogram
from bcapscope.protocol.slave_mode.modes import PERIOD_MS

LONGEST_CYCLE_MS = 8.0 * PERIOD_MS
"""A longer cycle counts as a pause."""

PROMPT_MS = 1.0
"""If a client waits only for the reply, its next set point follows the reply within this time in ms."""

_SKIPPED = 1.5
_PROMPT_SHARE = 0.8


class MotionPace(NamedTuple):
    """The pace of set points while the robot moves.

    Attributes:
        cycles: Number of cycles while the robot moves; pauses do not count.
        cycle_ms: Typical cycle time, ms: the mean of the cycles that skip no period. If most cycles skip a
            period, `cycle_ms` is the median of all cycles.
        long_cycle_ms: Cycle time that nine of ten cycles do not exceed.
        skipped: Number of cycles that are at least one and a half periods long.
        waits_for_reply: Whether the replies set the pace: the client sent most set points as soon as the
            previous reply arrived.
    """

    cycles: int
    cycle_ms: float
    long_cycle_ms: float
    skipped: int
    waits_for_reply: bool


class MotionPaceModel:
    def __init__(self) -> None:
        self._cycles, self._on_time = Histogram(), Histogram()
        self._prompt = 0
        self._last_reply = np.nan

    def add(self, rows: SetPointTable, cycles: Floats, in_motion: Bools, grid_ms: float) -> None:
        """Add set points. `cycles` has the cycle time before each set point, ms; NaN if unknown. `in_motion`
        is True if the robot moves both to this set point and to the previous set point.
        """
        # After lost packets, the time to the next set point does not show the client's pace.
        undisturbed = rows.answered & (rows.retries == 0)
        replies = np.where(undisturbed, rows.replies, np.nan)
        waited_for = np.concatenate(((self._last_reply,), replies[:-1]))
        self._last_reply = float(replies[-1])
        counted = in_motion & ~np.isnan(waited_for) & (cycles >= 0) & (cycles <= LONGEST_CYCLE_MS)
        idle = (rows.times - waited_for) / 1e6
        self._prompt += int(np.count_nonzero(counted & (idle >= 0) & (idle <= PROMPT_MS)))
        paced = cycles[counted]
        self._cycles.add(paced)
        self._on_time.add(paced[paced < _SKIPPED * grid_ms])

    def facts(self) -> MotionPace | None:
        every, on_time = self._cycles.distribution(), self._on_time.distribution()
        if every is None:
            return None
        skipped = every.count - (0 if on_time is None else on_time.count)
        usual = every.p50 if on_time is None or skipped > on_time.count else on_time.mean
        waits = self._prompt >= _PROMPT_SHARE * every.count
        return MotionPace(every.count, usual, every.p90, skipped, waits)
