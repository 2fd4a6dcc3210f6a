"""Compare the controller's time stamps with the clock of the capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.statistics.distribution import Floats, Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.modes import PERIOD_MS

_WORD = 1 << 32
_NS_PER_MS = 1_000_000
_LONG_ENOUGH_MS = 1000.0
_WRAP_AT_LEAST = 1 << 31

_US_AT_LEAST = 30.0
"""If time stamps advance by at least this number per ms of capture time, their unit is µs. The limit is near
the geometric mean of 1 (for time stamps in ms) and 1000 (for time stamps in µs).
"""


@dataclass(frozen=True, slots=True)
class ClockFacts:
    """Facts about the controller's clock and time stamps. Receive format 0x010 adds time stamps to replies.

    Attributes:
        microseconds: True if the time stamps are in µs, False if they are in ms.
        unit_known_by: How the unit is known: from a slvRecvFormat call, or from the rate of the time stamps.
        drift_ppm: How much faster the controller's clock runs than the clock of the capture, in ppm; None for
            fewer than three time stamps, or if the time stamps cover less than a second.
        jitter: Absolute change of the network delay from one reply to the next, ms; None for fewer than two
            time stamps.
        step: Difference of successive time stamps, ms; None for fewer than two time stamps.
        missing: Number of periods between the first and the last time stamp without a time stamp.
        backwards: Number of time stamps that are earlier than the previous one, except where a counter wraps.
    """

    stamps: int
    microseconds: bool
    unit_known_by: Message
    drift_ppm: float | None
    jitter: DistributionSummary | None
    step: DistributionSummary | None
    missing: int
    repeated: int
    backwards: int
    wraps: int


class ControllerClock:
    """Compares the controller's time stamps with the times at which the replies were captured.

    A time stamp is a signed 32-bit number. The client chooses the unit, ms or µs (DENSORobot/denso_robot_ros2
    denso_robot_core). A time stamp in µs turns negative after 36 minutes and wraps every 72 minutes. The
    network delay is nearly constant, so the slope of capture times over time stamps shows the drift.
    """

    def __init__(self, microseconds: bool | None) -> None:
        """`microseconds` is None if the receive format is unknown."""
        self._unit_known = microseconds is not None
        self._microseconds = microseconds
        self._first: tuple[int, int] | None = None  # stamp and time
        # time in ms since the first time stamp, by the controller's clock and by the capture's clock
        self._last = (0.0, 0.0)
        self._raw_last = 0
        # last time stamp minus first time stamp, in the unit of the time stamps, with wraps added
        self._ticks = 0
        self._count = self._repeated = self._backwards = self._wraps = self._missing = 0
        # sums of x, y, x² and xy; x is controller time, y is capture time minus x
        self._sums = np.zeros(4)
        self._jitter, self._step = Histogram(), Histogram()

    def add(self, stamps: Floats, times: NDArray[np.int64]) -> None:
        """Add time stamps in the order of their replies, with the capture times of the replies in ns."""
        if not len(stamps):
            return
        raw = stamps.astype(np.int64)
        if self._first is None:
            self._first = int(raw[0]), int(times[0])
            self._raw_last = int(raw[0])
        steps = np.diff(raw, prepend=self._raw_last)
        unwrapped = (steps + _WORD // 2) % _WORD - _WORD // 2
        self._wraps += int((np.abs(steps) >= _WRAP_AT_LEAST).sum())
        ticks = self._ticks + np.cumsum(unwrapped)
        seen = (times - self._first[1]) / _NS_PER_MS
        if self._microseconds is None:
            self._microseconds = _counts_microseconds(ticks, seen)
        own = ticks / 1000.0 if self._microseconds else ticks.astype(np.float64)
        self._count_steps(own, seen, unwrapped)
        ahead = seen - own
        self._sums += own.sum(), ahead.sum(), (own * own).sum(), (own * ahead).sum()
        self._count += len(raw)
        self._raw_last, self._ticks = int(raw[-1]), int(ticks[-1])
        self._last = float(own[-1]), float(seen[-1])

    @property
    def microseconds(self) -> bool:
        """Whether the time stamps are in µs; False if they are in ms, or if the unit is not known yet."""
        return bool(self._microseconds)

    def facts(self) -> ClockFacts | None:
        if not self._count:
            return None
        return ClockFacts(
            stamps=self._count,
            microseconds=self.microseconds,
            unit_known_by=Message(f"clock.unit-by.{'format' if self._unit_known else 'pace'}"),
            drift_ppm=self._drift(),
            jitter=self._jitter.distribution(),
            step=self._step.distribution(bins=True),
            missing=self._missing,
            repeated=self._repeated,
            backwards=self._backwards,
            wraps=self._wraps,
        )

    def _count_steps(self, own: Floats, seen: Floats, ticks: NDArray[np.int64]) -> None:
        steps = np.diff(own, prepend=self._last[0])
        delays = np.diff(seen, prepend=self._last[1]) - steps
        if not self._count:
            steps, delays, ticks = steps[1:], delays[1:], ticks[1:]
        self._repeated += int((ticks == 0).sum())
        self._backwards += int((ticks < 0).sum())
        self._missing += int(np.clip(np.rint(steps / PERIOD_MS) - 1, 0, None).sum())
        self._step.add(steps)
        self._jitter.add(np.abs(delays))

    def _drift(self) -> float | None:
        """Return the slope of a least-squares line: how much faster the controller's clock runs, in ppm."""
        own, ahead, own_squared, product = self._sums.tolist()
        spread = self._count * own_squared - own * own
        if self._count < 3 or abs(self._last[0]) < _LONG_ENOUGH_MS or spread <= 0:
            return None
        slope = (self._count * product - own * ahead) / spread
        return -slope * 1e6


def _counts_microseconds(ticks: NDArray[np.int64], seen: Floats) -> bool | None:
    """Return whether time stamps advance fast enough to be in µs; None if no time has passed."""
    passed = float(seen[-1] - seen[0])
    counted = abs(int(ticks[-1]) - int(ticks[0]))
    return counted / passed >= _US_AT_LEAST if passed > 0 and counted else None
