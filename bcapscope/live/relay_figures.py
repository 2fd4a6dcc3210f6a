"""Performance figures of a proxy: datagrams per second, delays in the relay, losses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from bcapscope.analysis.statistics.distribution import Histogram
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Enumeration
from bcapscope.proxy.ring_buffer import SET_POINT_DEADLINE_NS, RelayCounter, RingRecord, RingRecordKind

_DEADLINE = f"{SET_POINT_DEADLINE_NS // 1_000_000} ms"
_LOSSES = (
    RelayCounter.LOST,
    RelayCounter.FULL,
    RelayCounter.DENIED,
    RelayCounter.RULED,
    RelayCounter.UNWATCHED,
)


class DelayStatistics:
    def __init__(self) -> None:
        self._histograms = {True: Histogram(), False: Histogram()}
        self._slow_count = 0
        self._worst_ns = 0
        self._has_warned = False

    def add_records(self, records: Iterable[RingRecord]) -> None:
        """Add the delays of records, except where a rule of the proxy may have delayed data on purpose."""
        found: dict[bool, list[int]] = {True: [], False: []}
        for kind, up, _, received, sent, _, note in records:
            if kind is RingRecordKind.DATA and received and sent and not note:
                found[up].append(sent - received)
        for up, delays in found.items():
            if delays:
                values = np.array(delays, np.float64)
                self._histograms[up].add(values / 1000)
                self._slow_count += int((values > SET_POINT_DEADLINE_NS).sum())
                self._worst_ns = max(self._worst_ns, *delays)

    def pop_warning(self) -> Message | None:
        """Return a warning, once, if the relay delayed data for longer than `SET_POINT_DEADLINE_NS`."""
        if self._has_warned or not self._slow_count:
            return None
        self._has_warned = True
        return Message("relay.slow", time=self._worst, limit=_DEADLINE)

    def status(self) -> Message | None:
        parts = [
            Message(f"relay.status.{name}", figures=f"{spread.p50:.0f}/{spread.p999:.0f}")
            for name, spread in self._spreads()
            if spread is not None
        ]
        return Message("relay.status", parts=Enumeration(tuple(parts))) if parts else None

    def figures(self) -> list[int]:
        """Return the delay figures in ns, in the order of `ring_buffer.DELAY_FIGURES`."""
        found: list[int] = []
        for _, spread in self._spreads():
            values = (0.0,) * 4 if spread is None else (spread.p50, spread.p99, spread.p999, spread.most)
            found += [round(value * 1000) for value in values]
        return [*found, self._slow_count]

    def summary(self) -> Iterator[Message]:
        for name, spread in self._spreads():
            if spread is not None:
                levels = ("p50", "p99", "p999", "most")
                figures = {level: f"{getattr(spread, level):.0f} µs" for level in levels}
                yield Message(f"relay.held.{name}", **figures)
        if self._slow_count:
            count = Count(self._slow_count, "time")
            yield Message("relay.slow.times", count=count, limit=_DEADLINE, worst=self._worst)

    def _spreads(self) -> Iterator[tuple[str, DistributionSummary | None]]:
        yield "up", self._histograms[True].distribution()
        yield "down", self._histograms[False].distribution()

    @property
    def _worst(self) -> str:
        return f"{self._worst_ns / 1e6:.1f} ms"


def rates(counts: Sequence[int], before: Sequence[int], seconds: float) -> Message:
    """Return datagrams per second that the relay sent. `before` holds the counts from `seconds` earlier."""
    up, down = (
        (counts[way] - before[way]) / seconds if before else 0.0
        for way in (RelayCounter.LEFT_UP, RelayCounter.LEFT_DOWN)
    )
    return Message("relay.rates", up=f"{up:.0f}", down=f"{down:.0f}")


def losses(counts: Sequence[int]) -> Iterator[Message]:
    """Yield a message for each kind of traffic that was lost, denied, changed by rules or not watched."""
    for counter in _LOSSES:
        if counts[counter]:
            yield Message(f"relay.{counter.name.lower()}", count=counts[counter])


def totals(counts: Sequence[int]) -> Iterator[Message]:
    yield Message("relay.clients", clients=Count(counts[RelayCounter.CLIENTS], "client"))
    names = "came_up", "left_up", "came_down", "left_down"
    yield Message("relay.datagrams", **{name: counts[RelayCounter[name.upper()]] for name in names})
    up, down = counts[RelayCounter.BYTES_UP], counts[RelayCounter.BYTES_DOWN]
    if up or down:
        yield Message("relay.bytes", up=up, down=down)
