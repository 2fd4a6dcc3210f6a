"""Performance figures of a proxy: datagrams per second, delays in the relay, losses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from bcapscope.analysis.statistics.distribution import DistributionSummary, Histogram
from bcapscope.protocol.text_format import counted
from bcapscope.proxy.ring_buffer import SET_POINT_DEADLINE_NS, RelayCounter, RingRecord, RingRecordKind

_DIRECTIONS = ((True, "to the controller"), (False, "to the client"))


class DelayStatistics:
    """Delays in the relay of data that was forwarded unchanged."""

    def __init__(self) -> None:
        self._histograms = {True: Histogram(), False: Histogram()}
        self._slow_count = 0
        self._worst_ns = 0
        self._has_warned = False

    def add_records(self, records: Iterable[RingRecord]) -> None:
        """Add the delays of records, except of data that a rule touched: rules may delay on purpose."""
        found: dict[bool, list[int]] = {True: [], False: []}
        for kind, up, _, came, left, _, note in records:
            if kind is RingRecordKind.DATA and came and left and not note:
                found[up].append(left - came)
        for up, delays in found.items():
            if delays:
                values = np.array(delays, np.float64)
                self._histograms[up].add(values / 1000)
                self._slow_count += int((values > SET_POINT_DEADLINE_NS).sum())
                self._worst_ns = max(self._worst_ns, *delays)

    def pop_warning(self) -> str:
        """Return a warning the first time that the proxy is too slow for set points; otherwise ""."""
        if self._has_warned or not self._slow_count:
            return ""
        self._has_warned = True
        return (
            f"the proxy itself held something for {self._worst_ns / 1e6:.1f} ms, longer than the "
            f"{SET_POINT_DEADLINE_NS // 1_000_000} ms in which a set point has to be answered"
        )

    def status_text(self) -> str:
        """Return the median and the 99.9th percentile of both directions, as text; "" without data."""
        parts = []
        for up, name in ((True, "up"), (False, "down")):
            spread = self._histograms[up].distribution()
            if spread is not None:
                parts.append(f"{name} {spread.p50:.0f}/{spread.p999:.0f}")
        return f"held p50/p99.9 µs {', '.join(parts)}" if parts else ""

    def figures(self) -> list[int]:
        """Return the figures for the relay, in ns; see `ring_buffer.DELAY_FIGURES`."""
        found: list[int] = []
        for up, _ in _DIRECTIONS:
            spread = self._histograms[up].distribution()
            values = (0.0,) * 4 if spread is None else (spread.p50, spread.p99, spread.p999, spread.most)
            found += [round(value * 1000) for value in values]
        return [*found, self._slow_count]

    def summary_lines(self) -> Iterator[str]:
        for up, name in _DIRECTIONS:
            spread = self._histograms[up].distribution()
            if spread is not None:
                yield f"held on the way {name}: {_spread_text(spread)}"
        if self._slow_count:
            text = counted(self._slow_count, "time")
            yield (
                f"{text} longer than the {SET_POINT_DEADLINE_NS // 1_000_000} ms of a set point, "
                f"{self._worst_ns / 1e6:.1f} ms at worst"
            )


def _spread_text(spread: DistributionSummary) -> str:
    return (
        f"p50 {spread.p50:.0f} µs, p99 {spread.p99:.0f} µs, p99.9 {spread.p999:.0f} µs, "
        f"at most {spread.most:.0f} µs"
    )


def rates_text(counts: Sequence[int], before: Sequence[int], seconds: float) -> str:
    """Return the datagrams sent per second since `before`, as text."""
    up, down = (
        (counts[way] - before[way]) / seconds if before else 0.0
        for way in (RelayCounter.LEFT_UP, RelayCounter.LEFT_DOWN)
    )
    return f"{up:.0f}/s up, {down:.0f}/s down"


def loss_lines(counts: Sequence[int]) -> Iterator[str]:
    """Yield a line for each kind of traffic that was lost, denied, changed by rules or not watched."""
    if counts[RelayCounter.LOST]:
        yield f"{counts[RelayCounter.LOST]} dropped by the system: no room in a socket's buffer"
    if counts[RelayCounter.FULL]:
        yield f"{counts[RelayCounter.FULL]} that the system would not send"
    if counts[RelayCounter.DENIED]:
        yield f"{counts[RelayCounter.DENIED]} of clients that are not allowed, or too many"
    if counts[RelayCounter.RULED]:
        yield f"{counts[RelayCounter.RULED]} touched by rules"
    if counts[RelayCounter.UNWATCHED]:
        yield f"{counts[RelayCounter.UNWATCHED]} passed unseen and unrecorded: watching was too slow"


def totals_text(counts: Sequence[int]) -> str:
    text = (
        f"{counted(counts[RelayCounter.CLIENTS], 'client')}; datagrams up {counts[RelayCounter.CAME_UP]} in, "
        f"{counts[RelayCounter.LEFT_UP]} out, down {counts[RelayCounter.CAME_DOWN]} in, "
        f"{counts[RelayCounter.LEFT_DOWN]} out"
    )
    if counts[RelayCounter.BYTES_UP] or counts[RelayCounter.BYTES_DOWN]:
        text += f"; TCP bytes up {counts[RelayCounter.BYTES_UP]}, down {counts[RelayCounter.BYTES_DOWN]}"
    return text
