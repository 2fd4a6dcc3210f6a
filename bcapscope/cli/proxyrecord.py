"""What a proxy recorded: both legs of all that passed, each on an interface of its own."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from typing import TypeAlias

from bcapscope.capture.packet import Interface
from bcapscope.capture.packetfile import Twins
from bcapscope.capture.recording import RAW, Hop, Recording
from bcapscope.capture.series import Bounds, Series
from bcapscope.proxy.ring import Kind, Record, unseen
from bcapscope.proxy.witness import met
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Transport

_Ends: TypeAlias = tuple[tuple[str, int], tuple[str, int]]


class _Leg:
    """One of the two ways that what a client and its controller say takes.

    Attributes:
        where: the interface.
        is_near: it is the client's.
        is_stream: it is a TCP connection.
        begun: that connection is in the recording.
        ends: who speaks to whom; what goes down at 0, up at 1.
    """

    __slots__ = ("begun", "ends", "is_near", "is_stream", "where")

    def __init__(
        self, name: str, asking: tuple[str, int], asked: tuple[str, int], *, is_near: bool, is_stream: bool
    ) -> None:
        self.where = Interface(RAW, name)
        self.is_near = is_near
        self.is_stream = is_stream
        self.begun = False
        self.ends: tuple[_Ends, _Ends] = (asked, asking), (asking, asked)

    def hop(self, up: bool) -> Hop:
        """Return where datagrams go."""
        return (*self.ends[up], self.where)


_Step: TypeAlias = tuple[int, _Leg, Record]
"""When what is to be written of a record, and where."""

_time: Callable[[_Step], int] = itemgetter(0)

_MOST_PASSAGES = 1024
"""Of so many clients, directions and sizes is kept what makes blocks; when there are more, all of it goes."""


class ProxyRecorder:
    """Writes the relay's traffic to a capture; if that fails, reports it and continues without.

    Attributes:
        failed: the capture lacks something because a file could not be written.
    """

    def __init__(self, path: Path, bounds: Bounds | None, tell: Callable[[str], None]) -> None:
        """Begin.

        Raises:
            OSError: it cannot be written.
        """
        self._series: Series | None = Series(path, bounds)
        self.failed = self._has_told_full = False
        self._path = path
        self._tell = tell
        self._legs: dict[int, tuple[_Leg, _Leg]] = {}
        self._steps: list[_Step] = []
        self._is_ring = bounds is not None
        self._passages: dict[tuple[int, bool, int], Twins] = {}  # by client, whether up, and bytes

    def take(self, records: Sequence[Record]) -> None:
        """Write what was told, in the order of its times; what may not be the next one waits for `flush`."""
        if self._series is None:
            return
        rest = records[self._pass(records) :]
        if self._series is None:
            return
        steps, legs, came = self._steps, self._legs, 0
        for record in rest:
            if record.kind is Kind.OPENED:
                self._meet(record)
            known = legs.get(record.client)
            if known is None:
                continue
            near, far = known
            came = max(came, record.came)
            if record.kind is Kind.OPENED or record.kind is Kind.GONE:
                steps.append((record.came, near, record))
                continue
            first, second = (near, far) if record.up else (far, near)
            if record.came:
                steps.append((record.came, first, record))
            if record.left:
                steps.append((record.left, second, record))
        steps.sort(key=_time)
        self._write(bisect_right(steps, came, key=_time))

    def _pass(self, records: Sequence[Record]) -> int:
        """Write datagrams that were passed on as they came, one after another, which most are.

        What waits is written before, if all of `records` is later.

        Returns:
            How many records were written, from the first on; never the last, as something may overtake it.
        """
        first = [
            came if 0 < came <= left else left or came for _, _, _, came, left, _, _ in reversed(records)
        ]
        soonest = [*accumulate(first, min)][::-1]  # when the first of each and of all that follow is written
        if len(records) < 2 or (self._steps and soonest[0] < self._steps[-1][0]):
            return 0
        self._write(len(self._steps))
        if self._series is None:
            return 0
        blocks: list[bytes] = []
        written = 0
        try:
            for (kind, up, number, came, left, data, note), following in zip(
                records, soonest[1:], strict=False
            ):
                if not 0 < came <= left <= following or note or kind is not Kind.DATA:
                    break
                if self._is_ring and self._sends_datagrams(number):
                    written += self._put(blocks)
                    self._recording()
                make = self._passages.get((number, up, len(data))) or self._passage(number, up, len(data))
                if make is None:
                    break
                blocks.append(make(came, left, data))
            written += self._put(blocks)
        except OSError as error:
            self._give_up(error)
        return written

    def _put(self, blocks: list[bytes]) -> int:
        """Write blocks and empty the list; return how many they were."""
        assert self._series is not None
        count = len(blocks)
        if count:
            self._series.recording.put(b"".join(blocks))
            blocks.clear()
        return count

    def _passage(self, number: int, up: bool, size: int) -> Twins | None:
        """Return what writes datagrams of so many bytes; None for a stream, and for an unknown client."""
        if not self._sends_datagrams(number):
            return None
        if len(self._passages) >= _MOST_PASSAGES:
            self._passages.clear()
        near, far = self._legs[number]
        first, second = (near, far) if up else (far, near)
        made = self._recording().passing(first.hop(up), second.hop(up), size)
        self._passages[number, up, size] = made
        return made

    def _sends_datagrams(self, number: int) -> bool:
        """Tell whether a client is known and sends datagrams."""
        legs = self._legs.get(number)
        return legs is not None and not legs[0].is_stream

    def flush(self) -> None:
        """Put all that was taken into the file."""
        self._write(len(self._steps))
        if self._series is not None:
            try:
                self._series.flush()
            except OSError as error:
                self._give_up(error)
            else:
                self._tell_freed(self._series.freed)

    def _tell_freed(self, freed: int) -> None:
        """Report once that the disk is too small for the ring."""
        if freed and not self._has_told_full:
            self._has_told_full = True
            name = printable(str(self._path))
            self._tell(f"the disk is full: the recording {name} removes its oldest files early")

    def close(self) -> None:
        """Close the file, with all that was taken in it."""
        self.flush()
        self._shut()

    def _shut(self) -> None:
        self._steps.clear()
        if self._series is not None:
            self._series.close()
            self._series = None

    def _meet(self, record: Record) -> None:
        who = met(record)
        is_stream = who.transport is Transport.TCP
        self._legs[record.client] = (
            _Leg(f"clients of {who.listen}", who.client, who.listen, is_near=True, is_stream=is_stream),
            _Leg(
                f"controller {who.controller}",
                who.upstream,
                who.controller,
                is_near=False,
                is_stream=is_stream,
            ),
        )

    def _write(self, count: int) -> None:
        """Write so many of the steps."""
        steps, self._steps = self._steps[:count], self._steps[count:]
        try:
            for time, leg, record in steps:
                if record.kind is Kind.DATA:
                    self._add(time, leg, record)
                else:
                    self._open_or_end(time, leg, record)
        except OSError as error:
            self._give_up(error)

    def _open_or_end(self, time: int, leg: _Leg, record: Record) -> None:
        if record.kind is Kind.GONE:
            self._forget(record.client)
        elif record.kind is Kind.HOLE:
            self._skip(leg, record, time)
        elif record.kind is not Kind.OPENED:
            self._end(leg, record, time)
        elif leg.is_stream:
            self._begin(leg, time)

    def _give_up(self, error: OSError) -> None:
        self.failed = True
        why = (error.strerror or str(error)).lower()
        self._tell(f"{printable(str(self._path))} is not written any more: {why}")
        self._shut()

    def _recording(self) -> Recording:
        """Return what packets are written with, to the next file where it is time to."""
        assert self._series is not None
        if self._series.turn():
            self._passages.clear()  # they name interfaces of the file before
        return self._series.recording

    def _begin(self, leg: _Leg, time: int) -> None:
        leg.begun = True
        self._recording().opened(*leg.ends[1], time, where=leg.where)

    def _add(self, time: int, leg: _Leg, record: Record) -> None:
        source, target = leg.ends[record.up]
        data, note = record.data, record.note
        if leg.is_stream:
            if not leg.begun:
                self._begin(leg, time)
            self._recording().segment(source, target, data, time, where=leg.where, comment=note)
        else:
            self._recording().datagram(source, target, data, time, where=leg.where, comment=note)

    def _skip(self, leg: _Leg, record: Record, time: int) -> None:
        """Leave a gap in the sequence numbers."""
        assert self._series is not None
        came, left = unseen(record)
        if not leg.begun:
            self._begin(leg, time)
        self._series.recording.skipped(*leg.ends[record.up], came if leg.is_near is record.up else left)

    def _end(self, leg: _Leg, record: Record, time: int) -> None:
        """Write the end of a direction, of a connection that is in the recording."""
        if leg.begun:
            self._recording().finished(
                *leg.ends[record.up],
                time,
                where=leg.where,
                reset=record.kind is Kind.RESET,
                comment=record.data.decode("utf-8", "replace"),
            )

    def _forget(self, client: int) -> None:
        assert self._series is not None
        for key in [key for key in self._passages if key[0] == client]:
            del self._passages[key]
        for leg in self._legs.pop(client):
            self._series.recording.ended(*leg.ends[1])
