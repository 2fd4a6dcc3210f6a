"""How a proxy does: what passes a second, how long it holds what passes, what was lost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from bcapscope.analysis.distribution import Distribution, Histogram
from bcapscope.protocol.wording import counted
from bcapscope.proxy.ring import SET_POINT, Count, Kind, Record

_NAMES = ((True, "to the controller"), (False, "to the client"))


class Delays:
    """How long the relay held what it passed on as it came."""

    def __init__(self) -> None:
        self._histograms = {True: Histogram(), False: Histogram()}
        self._slow = 0
        self._worst = 0
        self._told = False

    def add(self, records: Iterable[Record]) -> None:
        """Take in what passed; what a rule touched is not meant to pass at once."""
        found: dict[bool, list[int]] = {True: [], False: []}
        for kind, up, _, came, left, _, note in records:
            if kind is Kind.DATA and came and left and not note:
                found[up].append(left - came)
        for up, delays in found.items():
            if delays:
                values = np.array(delays, np.float64)
                self._histograms[up].add(values / 1000)
                self._slow += int((values > SET_POINT).sum())
                self._worst = max(self._worst, *delays)

    def warning(self) -> str:
        """Return, once, that the proxy is too slow for set points; "" if it is not or that was told."""
        if self._told or not self._slow:
            return ""
        self._told = True
        return (
            f"the proxy itself held something for {self._worst / 1e6:.1f} ms, longer than the "
            f"{SET_POINT // 1_000_000} ms in which a set point has to be answered"
        )

    def brief(self) -> str:
        """Return the median and the worst thousandth of both directions, in a few words."""
        parts = []
        for up, name in ((True, "up"), (False, "down")):
            spread = self._histograms[up].distribution()
            if spread is not None:
                parts.append(f"{name} {spread.p50:.0f}/{spread.p999:.0f}")
        return f"held p50/p99.9 µs {', '.join(parts)}" if parts else ""

    def figures(self) -> list[int]:
        """Return what `ring.Figure` lists."""
        found: list[int] = []
        for up, _ in _NAMES:
            spread = self._histograms[up].distribution()
            values = (0.0,) * 4 if spread is None else (spread.p50, spread.p99, spread.p999, spread.most)
            found += [round(value * 1000) for value in values]
        return [*found, self._slow]

    def lines(self) -> Iterator[str]:
        """Sum up."""
        for up, name in _NAMES:
            spread = self._histograms[up].distribution()
            if spread is not None:
                yield f"held on the way {name}: {_spread(spread)}"
        if self._slow:
            text = counted(self._slow, "time")
            yield (
                f"{text} longer than the {SET_POINT // 1_000_000} ms of a set point, "
                f"{self._worst / 1e6:.1f} ms at worst"
            )


def _spread(spread: Distribution) -> str:
    return (
        f"p50 {spread.p50:.0f} µs, p99 {spread.p99:.0f} µs, p99.9 {spread.p999:.0f} µs, "
        f"at most {spread.most:.0f} µs"
    )


def rates(counts: Sequence[int], before: Sequence[int], seconds: float) -> str:
    """Return what passed a second, in a few words.

    Args:
        counts: by `Count`.
        before: the same at some time before.
        seconds: since then.
    """
    up, down = (
        (counts[way] - before[way]) / seconds if before else 0.0 for way in (Count.LEFT_UP, Count.LEFT_DOWN)
    )
    return f"{up:.0f}/s up, {down:.0f}/s down"


def losses(counts: Sequence[int]) -> Iterator[str]:
    """Yield what did not pass, or was not watched."""
    if counts[Count.LOST]:
        yield f"{counts[Count.LOST]} dropped by the system: no room in a socket's buffer"
    if counts[Count.FULL]:
        yield f"{counts[Count.FULL]} that the system would not send"
    if counts[Count.DENIED]:
        yield f"{counts[Count.DENIED]} of clients that are not allowed, or too many"
    if counts[Count.RULED]:
        yield f"{counts[Count.RULED]} touched by rules"
    if counts[Count.UNWATCHED]:
        yield f"{counts[Count.UNWATCHED]} passed unseen and unrecorded: watching was too slow"


def totals(counts: Sequence[int]) -> str:
    """Return what passed in all."""
    text = (
        f"{counted(counts[Count.CLIENTS], 'client')}; datagrams up {counts[Count.CAME_UP]} in, "
        f"{counts[Count.LEFT_UP]} out, down {counts[Count.CAME_DOWN]} in, {counts[Count.LEFT_DOWN]} out"
    )
    if counts[Count.BYTES_UP] or counts[Count.BYTES_DOWN]:
        text += f"; TCP bytes up {counts[Count.BYTES_UP]}, down {counts[Count.BYTES_DOWN]}"
    return text
