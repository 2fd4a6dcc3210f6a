"""What a proxy recorded: both legs of all that passed, each on an interface of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from bcapscope.capture.packet import Interface
from bcapscope.capture.recording import RAW, Recording
from bcapscope.capture.series import Bounds, Series
from bcapscope.proxy.ring import Kind, Record
from bcapscope.proxy.witness import Met, met
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Transport


class _Leg:
    """One of the two ways that what a client and its controller say takes.

    Attributes:
        where: the interface.
        asking: the end from which requests come.
        asked: the other.
        begun: the TCP connection is in the recording.
    """

    __slots__ = ("asked", "asking", "begun", "where")

    def __init__(self, name: str, asking: tuple[str, int], asked: tuple[str, int]) -> None:
        self.where = Interface(RAW, name)
        self.asking = asking
        self.asked = asked
        self.begun = False

    def ends(self, up: bool) -> tuple[tuple[str, int], tuple[str, int]]:
        """Return who speaks to whom."""
        return (self.asking, self.asked) if up else (self.asked, self.asking)


class ProxyRecorder:
    """Writes what the relay tells to a capture; when that fails, it says so and goes on without."""

    def __init__(self, path: Path, bounds: Bounds | None, tell: Callable[[str], None]) -> None:
        """Begin.

        Raises:
            OSError: it cannot be written.
        """
        self._series: Series | None = Series(path, bounds)
        self._path = path
        self._tell = tell
        self._legs: dict[int, tuple[Transport, _Leg, _Leg]] = {}

    def take(self, records: Iterable[Record]) -> None:
        """Write what was told, in the order of its times."""
        series = self._series
        if series is None:
            return
        steps: list[tuple[int, Callable[[int], None]]] = []
        for record in records:
            if record.kind is Kind.OPENED:
                self._meet(met(record), record, steps)
            elif record.client in self._legs and record.kind is Kind.GONE:
                steps.append((record.came, partial(self._forget, record.client)))
            elif record.client in self._legs:
                self._add(record, steps)
        steps.sort(key=_time)
        try:
            for time, write in steps:
                write(time)
            series.flush()
        except OSError as error:
            why = (error.strerror or str(error)).lower()
            self._tell(f"{printable(str(self._path))} is not written any more: {why}")
            self.close()

    def close(self) -> None:
        """Close the file; what was taken is in it."""
        if self._series is not None:
            self._series.close()
            self._series = None

    def _recording(self) -> Recording:
        """Return what packets are written with, to the next file where it is time to."""
        assert self._series is not None
        self._series.turn()
        return self._series.recording

    def _meet(self, who: Met, record: Record, steps: list[tuple[int, Callable[[int], None]]]) -> None:
        near = _Leg(f"clients of {who.listen}", who.client, who.listen)
        far = _Leg(f"controller {who.controller}", who.upstream, who.controller)
        self._legs[record.client] = who.transport, near, far
        if who.transport is Transport.TCP:
            steps.append((record.came, partial(self._begin, near)))

    def _begin(self, leg: _Leg, time: int) -> None:
        leg.begun = True
        self._recording().opened(leg.asking, leg.asked, time, where=leg.where)

    def _add(self, record: Record, steps: list[tuple[int, Callable[[int], None]]]) -> None:
        transport, near, far = self._legs[record.client]
        first, second = (near, far) if record.up else (far, near)
        for time, leg in ((record.came, first), (record.left, second)):
            if time:
                steps.append((time, partial(self._write, transport, leg, record)))

    def _write(self, transport: Transport, leg: _Leg, record: Record, time: int) -> None:
        source, target = leg.ends(record.up)
        if record.kind is not Kind.DATA:
            self._end(leg, record, time)
        elif transport is Transport.TCP:
            if not leg.begun:
                self._begin(leg, time)
            self._recording().segment(source, target, record.data, time, where=leg.where, comment=record.note)
        else:
            self._recording().datagram(
                source, target, record.data, time, where=leg.where, comment=record.note
            )

    def _end(self, leg: _Leg, record: Record, time: int) -> None:
        """Write the end of a direction, of a connection that is in the recording."""
        if leg.begun:
            self._recording().finished(
                *leg.ends(record.up),
                time,
                where=leg.where,
                reset=record.kind is Kind.RESET,
                comment=record.data.decode("utf-8", "replace"),
            )

    def _forget(self, client: int, time: int) -> None:
        assert self._series is not None
        _, *legs = self._legs.pop(client)
        for leg in legs:
            self._series.recording.ended(leg.asking, leg.asked)


def _time(step: tuple[int, Callable[[int], None]]) -> int:
    return step[0]
