"""Calls that were asked for, and which incidents concern them."""

from __future__ import annotations

from collections.abc import Callable

from bcapscope.analysis.rules.rule import Incident, Report, all_seen
from bcapscope.protocol.frame import Frame
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.observation import Observation


class Choice:
    """Stands between the rules, which see all calls, and the book, which tells of some.

    A rule reasons about what was not called as well, so it has to see everything; an incident is asked for
    if one of the frames that prove it belongs to a call that was chosen. Whether a call is chosen is known
    when it settles: incidents about a frame that was only just seen wait for that.

    Attributes:
        calls: that were chosen so far.
    """

    def __init__(self, chosen: Callable[[Exchange], bool], report: Report) -> None:
        """Begin.

        Args:
            chosen: tells whether a call is asked for.
            report: is given every incident, marked.
        """
        self.calls = 0
        self._chosen = chosen
        self._pass_on = report
        self._bits = bytearray()  # a bit a frame
        self._awaited: int | None = None
        self._waiting: dict[int, list[Incident]] = {}

    def look(self, seen: Observation) -> None:
        """Hold what is reported from here on about a frame, until it settles what that belongs to."""
        self._awaited = seen.number if isinstance(seen.item, Frame) else None

    def settle(self, settled: Settled) -> None:
        """Take notice of what has settled, before the rules see it."""
        self._awaited = None
        whole = all_seen(settled) if isinstance(settled, Exchange) else (settled.seen,)
        frames = [seen.number for seen in whole]
        if isinstance(settled, Exchange) and self._chosen(settled):
            self.calls += 1
            for frame in frames:
                self._mark(frame)
        if self._waiting:
            for frame in frames:
                self._release(frame)

    def report(self, incident: Incident) -> None:
        """Take what a rule found."""
        if self._awaited is not None:
            self._waiting.setdefault(self._awaited, []).append(incident)
            return
        incident.asked = any(map(self._is_marked, incident.frames))
        self._pass_on(incident)

    def close(self) -> None:
        """Report what still waits: it concerns no call."""
        self._awaited = None
        for frame in list(self._waiting):
            self._release(frame)

    def _release(self, frame: int) -> None:
        for incident in self._waiting.pop(frame, ()):
            self.report(incident)

    def _mark(self, frame: int) -> None:
        byte, bit = divmod(frame, 8)
        if byte >= len(self._bits):
            self._bits.extend(bytes(byte + 1 - len(self._bits)))
        self._bits[byte] |= 1 << bit

    def _is_marked(self, frame: int) -> bool:
        byte, bit = divmod(frame, 8)
        return byte < len(self._bits) and bool(self._bits[byte] >> bit & 1)
