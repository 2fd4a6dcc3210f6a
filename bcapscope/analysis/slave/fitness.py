"""Judge from round-trip times whether a connection to a controller is fast enough for slave mode."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.messages.places import Quantity

SYNC_MS, ASYNC_MS = 8.0, 1.0
"""Periods of set points in Sync and Async modes (DENSO Wave 2009, How to use the Slave mode)."""

MAX_LOST = 0.01
"""Largest share of lost packets that retries can compensate. Sync modes allow seven retries, 2 ms apart."""


class Fitness(NamedTuple):
    period_ms: float
    fit: bool
    reason: Message


def fitness(round_trips: DistributionSummary | None, lost: int, broken: bool = False) -> tuple[Fitness, ...]:
    """Judge whether a connection is fast enough for set points every 8 ms and every 1 ms. `round_trips`
    holds round-trip times in ms; it is None if no call was answered.
    """
    periods = (SYNC_MS, ASYNC_MS)
    if broken:
        return tuple(Fitness(period, False, Message("fitness.broken")) for period in periods)
    return tuple(_judge_period(period, round_trips, lost) for period in periods)


def _judge_period(period: float, round_trips: DistributionSummary | None, lost: int) -> Fitness:
    if round_trips is None:
        return Fitness(period, False, Message("fitness.no-answer"))
    share = lost / (round_trips.count + lost)
    if share > MAX_LOST:
        return Fitness(period, False, Message("fitness.lost", share=Quantity(100 * share, "%", 1)))
    reason = Message(
        "fitness.round-trips", share=Quantity(99.9, "%", 1), time=Quantity(round_trips.p999, "ms", 3)
    )
    return Fitness(period, round_trips.p999 <= period, reason)
