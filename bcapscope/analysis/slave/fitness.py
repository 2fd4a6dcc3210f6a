"""Whether a way to a controller is fast enough for slave mode, judged by round trips."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.analysis.statistics.distribution import DistributionSummary

SYNC_MS, ASYNC_MS = 8.0, 1.0
"""Between set points (DENSO Wave 2009, How to use the Slave mode): 8 ms in Sync, 1 ms in Async modes."""

MAX_LOST = 0.01
"""Share of packets that retries make good: a Sync slvMove has seven of them, 2 ms apart."""


class Fitness(NamedTuple):
    """A verdict.

    Attributes:
        period_ms: between set points, ms.
        fit: it is fast enough.
        reason: one clause.
    """

    period_ms: float
    fit: bool
    reason: str


def fitness(round_trips: DistributionSummary | None, lost: int, broken: bool = False) -> tuple[Fitness, ...]:
    """Judge a way to a controller for set points each 8 ms and each 1 ms.

    Args:
        round_trips: ms of the calls that were answered; None where none was.
        lost: calls that were not.
        broken: the connection did not last.
    """
    periods = (SYNC_MS, ASYNC_MS)
    if broken:
        return tuple(Fitness(period, False, "the connection broke") for period in periods)
    return tuple(_judge_period(period, round_trips, lost) for period in periods)


def _judge_period(period: float, round_trips: DistributionSummary | None, lost: int) -> Fitness:
    if round_trips is None:
        return Fitness(period, False, "nothing was answered")
    share = lost / (round_trips.count + lost)
    if share > MAX_LOST:
        return Fitness(period, False, f"{share:.1%} of the calls were lost")
    slow = round_trips.p999 > period
    reason = f"99.9% of the answers within {round_trips.p999:.3f} ms"
    return Fitness(period, not slow, reason)
