"""Read several captures as one, in the order of their packets."""

from __future__ import annotations

import stat
from array import array
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from heapq import heappop, heappush
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet import Packet, PacketOrigin
from bcapscope.errors import CaptureError

if TYPE_CHECKING:
    from bcapscope.traffic.joining.clock_estimate import ClockEstimate

STDIN = "-"
"""Path of standard input."""

MAX_RUNS = 2_000_000
"""Maximum number of entries in a `RunTable` (40 MB). A full table gets no new entries, so `find` returns None
for numbers that would need a new entry.
"""

_NEVER = 1 << 64  # a time later than that of any packet, ns since 1970

_Reading: TypeAlias = "tuple[int, int, Packet, Iterator[Packet]]"
"""An open capture: time of its next packet, its index, its next packet, an iterator over later packets."""


class _Input(NamedTuple):
    """A capture. `began` is the first packet's time, ns since 1970; 0 if unknown. A stream has no `size`."""

    path: str
    began: int
    size: int | None


class CaptureSequence:
    """Several captures that are read as one.

    Files are read in the order of their first packets. If files overlap in time, their packets are merged by
    time. A stream keeps its place in the list of paths, because its first packet cannot be read in advance.

    Attributes:
        paths: Paths of the captures. `__iter__` puts `paths` in the order of reading.
        size: Size of all files in bytes; None before `__iter__` is called, or if one capture is a stream.
    """

    def __init__(
        self,
        paths: Sequence[str],
        names: Mapping[str, str],
        open_file: Callable[[str], CaptureFile],
        on_problem: Callable[[str, CaptureError], None],
        clocks: Mapping[str, ClockEstimate] | None = None,
    ) -> None:
        """Prepare to read captures.

        Args:
            names: For each path, the name that users see.
            on_problem: Receives the path and the error of a capture that cannot be read to its end. bcapscope
                then reads the next capture.
            clocks: Clocks of captures whose times are converted to the clock at the client's side; the key is
                the path. If `clocks` is not None, captures are read one after another and never merged by
                time, because a clock's error can exceed the time between two packets.
        """
        self.paths = list(paths)
        self.size: int | None = None
        self._open_file = open_file
        self._on_problem = on_problem
        self._clocks = clocks or {}
        self._in_turn = clocks is not None
        self._open: dict[int, CaptureFile] = {}
        self._bytes_finished = 0
        self._counts: list[int] = []
        self._runs = RunTable()
        self._names = names

    @property
    def position(self) -> int:
        return self._bytes_finished + sum(each.position for each in self._open.values())

    def origin_of(self, packet: int) -> PacketOrigin | None:
        """Return the capture that holds a packet, and the packet's number there; None if not known."""
        found = self._runs.find(packet)
        if found is None:
            return None
        path = self.paths[found[0]]
        return PacketOrigin(path, self._names[path], found[1])

    def __iter__(self) -> Iterator[Packet]:
        inputs = self._in_order()
        self.paths = [each.path for each in inputs]
        self._counts = [0] * len(inputs)
        sizes = [each.size for each in inputs if each.size is not None]
        self.size = sum(sizes) if len(sizes) == len(inputs) else None
        if len(inputs) == 1:
            self._runs.add(1, 0, 1)
            return self._packets_of(0)
        return self._packets_by_time(inputs)

    def _packets_by_time(self, inputs: Sequence[_Input]) -> Iterator[Packet]:
        in_turn = self._in_turn
        streams = (index if in_turn or each.size is None else -1 for index, each in enumerate(inputs))
        for _, part in groupby(zip(streams, enumerate(inputs), strict=True), lambda each: each[0]):
            yield from self._merged(deque((index, each.began) for _, (index, each) in part))

    def _in_order(self) -> list[_Input]:
        """Return the captures in the order of reading. Leave out files that have no packet."""
        inputs = [_Input(path, 0, _file_size(path)) for path in self.paths]
        if len(inputs) < 2 or self._in_turn:
            return inputs
        files = iter(sorted(self._dated(inputs), key=lambda each: each.began))
        ordered = (each if each.size is None else next(files, None) for each in inputs)
        return [each for each in ordered if each is not None]

    def _dated(self, inputs: Iterable[_Input]) -> Iterator[_Input]:
        for each in inputs:
            if each.size is None:
                continue
            try:
                with self._open_file(each.path) as file:
                    first = next(iter(file), None)
            except CaptureError as error:
                self._on_problem(each.path, error)
                continue
            if first is not None:
                yield each._replace(began=first[0])

    def _merged(self, waiting: deque[tuple[int, int]]) -> Iterator[Packet]:
        """Yield packets sorted by time. `waiting` holds index and start time of captures, earliest first."""
        reading: list[_Reading] = []
        while waiting or reading:
            while waiting and (not reading or waiting[0][1] <= reading[0][0]):
                index, _ = waiting.popleft()
                packets = self._packets_of(index)
                first = next(packets, None)
                if first is not None:
                    heappush(reading, (first[0], index, first, packets))
            if not reading:
                continue
            _, index, packet, packets = heappop(reading)
            until = min(reading[0][0] if reading else _NEVER, waiting[0][1] if waiting else _NEVER)
            count = self._counts[index]
            self._runs.add(sum(self._counts) + 1, index, count + 1)
            following: Packet | None = packet
            while following is not None and following[0] <= until:
                count += 1
                yield following
                following = next(packets, None)
            self._counts[index] = count
            if following is not None:
                heappush(reading, (following[0], index, following, packets))

    def _packets_of(self, index: int) -> Iterator[Packet]:
        path = self.paths[index]
        try:
            with self._open_file(path) as file:
                self._open[index] = file
                yield from self._timed(path, file)
        except CaptureError as error:
            self._on_problem(path, error)
        finally:
            opened = self._open.pop(index, None)
            self._bytes_finished += opened.position if opened is not None else 0

    def _timed(self, path: str, file: CaptureFile) -> Iterator[Packet]:
        clock = self._clocks.get(path)
        if clock is None:
            return iter(file)
        convert = clock.to_client_clock
        return ((convert(packet[0]), *packet[1:]) for packet in file)


def capture_names(paths: Sequence[str]) -> dict[str, str]:
    """Return the names that users see: the file names, or the paths of captures with the same file name."""
    count = Counter(Path(path).name for path in paths)
    return {path: name if count[name := Path(path).name] == 1 else path for path in paths}


class RunTable:
    """Maps numbers to sources: packet 1200 of all captures may be packet 200 of the second capture."""

    def __init__(self) -> None:
        self._starts = array("Q")
        self._sources = array("I")
        self._numbers = array("Q")

    def add(self, start: int, source: int, number: int) -> None:
        """Add an entry, or replace the latest entry if that entry has the same `start`. For example, after
        `add(1001, 1, 1)`, `find(1200)` returns `(1, 200)`.
        """
        if len(self._starts) > MAX_RUNS:
            return
        if self._starts:
            same_distance = number - start == self._numbers[-1] - self._starts[-1]
            if same_distance and source == self._sources[-1]:
                return
            if start == self._starts[-1]:
                self._sources[-1], self._numbers[-1] = source, number
                return
        self._starts.append(start)
        self._sources.append(source)
        self._numbers.append(number)

    def find(self, number: int) -> tuple[int, int] | None:
        """Return the source (such as a capture's index) and the number in this source; None if not known."""
        at = bisect_right(self._starts, number) - 1
        if at < 0 or at == MAX_RUNS:
            return None
        return self._sources[at], self._numbers[at] + number - self._starts[at]


def _file_size(path: str) -> int | None:
    """Return the size of a file in bytes; 0 if the file does not exist; None for a stream."""
    try:
        status = Path(path).stat()
    except OSError:
        return None if path == STDIN else 0
    return status.st_size if stat.S_ISREG(status.st_mode) else None
