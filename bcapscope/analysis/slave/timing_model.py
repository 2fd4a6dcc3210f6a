"""Timing of a slave-mode session: when the client sent set points, and how fast the controller answered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcapscope.analysis.slave.buffer_model import slack_ms
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED, SetPointFact
from bcapscope.analysis.slave.set_point_table import SetPointTable
from bcapscope.analysis.statistics.distribution import Floats, Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Quantity
from bcapscope.protocol.slave_mode.modes import PERIOD_MS, ModeKind, SlaveMode
from bcapscope.traffic.observation import Transport

FAST_GRID_MS = 1
"""Recommended period in ms for modes in which a new set point replaces the waiting one (DENSO Wave 2009)."""

FAST_BELOW_MS = 3.0
"""In modes without a fixed period, a median cycle time below this number of ms shows a period of 1 ms."""

MAX_SLOWEST = 16
_ON_GRID = 0.1
_SKIPPED = 1.5
_GUIDE = "DENSO Wave 2009, How to use the Slave mode"
_DRIVER = "DENSORobot/denso_robot_ros2 denso_robot_core"


class Deadline(NamedTuple):
    """A recommended time-out, and how many set points were not answered within the time-out.

    Attributes:
        timeout_ms: Time-out of one attempt, ms.
        tries: Maximum number of attempts, including the first.
        late: Number of set points that were not answered within one time-out after the first request.
        given_up: Number of set points that were not answered within the time-outs of all attempts together.
        applies: Whether the time-out is recommended for the session's mode and transport.
    """

    name: Message
    timeout_ms: float
    tries: int
    late: int
    given_up: int
    applies: bool
    source: str


@dataclass(frozen=True, slots=True)
class TimingFacts:
    """Facts about when set points were sent and answered.

    Attributes:
        cycle: Time between the first requests of successive set points, ms; None for fewer than two set
            points.
        grid_ms: Cycle time that the client should keep: 8 ms or 1 ms.
        grid_known_by: Reason for `grid_ms`; None if there are no set points.
        jitter: Absolute difference of each cycle time from `grid_ms`, ms; None for fewer than two set points.
        on_grid: Number of cycles that differ from `grid_ms` by at most 10 %.
        skipped: Number of cycles that are at least one and a half times as long as `grid_ms`.
        backwards: Number of set points, not in `cycle`, with an earlier time than the previous set point.
        rate_hz: Set points per second over the whole slave-mode session; None for fewer than two set points.
        latency: Time from the first request to the accepted reply, ms; None if no reply was captured.
        rtt: Time from the answered attempt to the accepted reply, ms; None if no reply was captured.
        slowest: The slowest set points: first those without a reply, then those with the longest latency.
        slack_ms: Time until a full buffer is empty if no new set point arrives, ms.
        gaps: Number of cycles longer than `slack_ms`.
    """

    cycle: DistributionSummary | None
    grid_ms: float
    grid_known_by: Message | None
    jitter: DistributionSummary | None
    on_grid: int
    skipped: int
    backwards: int
    rate_hz: float | None
    latency: DistributionSummary | None
    rtt: DistributionSummary | None
    deadlines: tuple[Deadline, ...]
    slowest: tuple[SetPointFact, ...]
    slack_ms: float
    gaps: int
    gap_list: tuple[SetPointFact, ...]


def _deadline(name: Message, timeout_ms: float, tries: int, source: str) -> Deadline:
    return Deadline(name, timeout_ms, tries, late=0, given_up=0, applies=False, source=source)


def _ros_deadline(case: str, timeout_ms: float) -> Deadline:
    name = Message(f"timeout.{case}", timeout=Quantity(timeout_ms, "ms"), attempts=Count(3, "attempt"))
    return _deadline(name, timeout_ms, 3, _DRIVER)


_SYNC = Message("timeout.sync", timeout=Quantity(2, "ms"), retries=Count(7, "retry"))
_ASYNC = Message("timeout.async", timeout=Quantity(2, "ms"))

# Each row has a time-out for slvMove, the modes that use this time-out, and whether only UDP uses it.
RECOMMENDED_TIMEOUTS: tuple[tuple[Deadline, tuple[ModeKind, ...], bool], ...] = (
    (_deadline(_SYNC, 2.0, 8, _GUIDE), (ModeKind.SYNC,), True),
    (_deadline(_ASYNC, 2.0, 1, _GUIDE), (ModeKind.ASYNC, ModeKind.MODE_1), True),
    (_ros_deadline("ros-mode-2", 16.0), (ModeKind.MODE_2,), False),
    (_ros_deadline("ros-modes-0-1", 8.0), (ModeKind.MODE_0, ModeKind.MODE_1), False),
)


class CycleGrid(NamedTuple):
    """The cycle time that a client should keep, and the reason."""

    ms: int
    known_by: Message | None = None


def choose_grid(overwrites: bool | None, cycles: Floats) -> CycleGrid:
    """Choose the cycle time that a client should keep. `cycles` has the first cycle times of the session, ms.
    `overwrites` is None if the mode is unknown.
    """
    pace = float(np.median(cycles)) if len(cycles) else float(PERIOD_MS)
    if overwrites is False:
        return CycleGrid(PERIOD_MS, Message("grid.mode", period=Quantity(PERIOD_MS, "ms")))
    fast, slow = Quantity(FAST_GRID_MS, "ms"), Quantity(PERIOD_MS, "ms")
    case = "newest-wins" if overwrites else "unknown-mode"
    if pace < FAST_BELOW_MS:
        return CycleGrid(FAST_GRID_MS, Message(f"grid.{case}", period=fast, other=slow))
    return CycleGrid(PERIOD_MS, Message(f"grid.{case}", period=slow, other=fast))


class TimingModel:
    def __init__(self, mode: SlaveMode | None, transport: Transport, slots: int) -> None:
        self.grid = CycleGrid(PERIOD_MS)
        self._mode = mode
        self._transport = transport
        self._slack_ms = slack_ms(slots)
        self._first: int | None = None
        self._last = 0  # time of the latest set point
        self._count = self._backwards = self._on_grid = self._skipped = self._gap_count = 0
        self._cycle, self._jitter, self._latency, self._rtt = (Histogram() for _ in range(4))
        self._late, self._given_up = [0] * len(RECOMMENDED_TIMEOUTS), [0] * len(RECOMMENDED_TIMEOUTS)
        self._slowest: list[tuple[float, SetPointFact]] = []
        self._gaps: list[SetPointFact] = []

    def add(self, rows: SetPointTable) -> Floats:
        """Return the cycle time before each set point, ms; NaN for the very first set point."""
        cycles = np.diff(rows.times, prepend=self._last) / 1e6
        if self._first is None:
            self._first = int(rows.times[0])
            cycles[0] = np.nan
            overwrites = None if self._mode is None else self._mode.overwrites_waiting
            self.grid = choose_grid(overwrites, cycles[1:])
        self._count += len(cycles)
        self._last = int(rows.times[-1])
        measured = cycles[~np.isnan(cycles)]
        self._add_cycles(measured)
        self._add_latencies(rows, cycles)
        self._add_gaps(rows, cycles)
        return cycles

    def _add_cycles(self, cycles: Floats) -> None:
        grid = self.grid.ms
        self._backwards += int(np.count_nonzero(cycles < 0))
        forward = cycles[cycles >= 0]
        off = np.abs(forward - grid)
        self._on_grid += int(np.count_nonzero(off <= _ON_GRID * grid))
        self._skipped += int(np.count_nonzero(forward >= _SKIPPED * grid))
        self._cycle.add(forward)
        self._jitter.add(off)

    def _add_latencies(self, rows: SetPointTable, cycles: Floats) -> None:
        latencies = rows.latencies
        answered = rows.answered
        self._latency.add(latencies[answered])
        self._rtt.add((rows.replies - rows.arrivals)[answered] / 1e6)
        judged = latencies[~rows.open]
        for index, (budget, _, _) in enumerate(RECOMMENDED_TIMEOUTS):
            self._late[index] += int(np.count_nonzero(judged > budget.timeout_ms))
            self._given_up[index] += int(np.count_nonzero(judged > budget.timeout_ms * budget.tries))
        known = np.where(rows.open, -1.0, latencies)
        least = self._slowest[-1][0] if len(self._slowest) == MAX_SLOWEST else -1.0
        slow = np.flatnonzero(known > least)
        if len(slow):
            slow = slow[np.argsort(-known[slow], kind="stable")][:MAX_SLOWEST]
            found = [(float(known[row]), rows.fact(row, cycles)) for row in slow.tolist()]
            merged = sorted((*self._slowest, *found), key=lambda each: -each[0])
            self._slowest = merged[:MAX_SLOWEST]

    def _add_gaps(self, rows: SetPointTable, cycles: Floats) -> None:
        gaps = np.flatnonzero(cycles > self._slack_ms)
        self._gap_count += len(gaps)
        for row in gaps[: MAX_LISTED - len(self._gaps)].tolist():
            self._gaps.append(rows.fact(row, cycles))

    def facts(self) -> TimingFacts:
        return TimingFacts(
            cycle=self._cycle.distribution(bins=True),
            grid_ms=float(self.grid.ms),
            grid_known_by=self.grid.known_by,
            jitter=self._jitter.distribution(),
            on_grid=self._on_grid,
            skipped=self._skipped,
            backwards=self._backwards,
            rate_hz=self._rate(),
            latency=self._latency.distribution(bins=True),
            rtt=self._rtt.distribution(),
            deadlines=tuple(self._deadlines()),
            slowest=tuple(fact for _, fact in self._slowest),
            slack_ms=self._slack_ms,
            gaps=self._gap_count,
            gap_list=tuple(self._gaps),
        )

    def _rate(self) -> float | None:
        lasted = self._last - (self._first or 0)
        return (self._count - 1) / (lasted / 1e9) if self._count > 1 and lasted > 0 else None

    def _deadlines(self) -> Iterator[Deadline]:
        kind = None if self._mode is None else self._mode.kind
        counts = zip(RECOMMENDED_TIMEOUTS, self._late, self._given_up, strict=True)
        for (deadline, kinds, udp_only), late, given_up in counts:
            applies = kind in kinds and (self._transport is Transport.UDP or not udp_only)
            yield deadline._replace(late=late, given_up=given_up, applies=applies)
